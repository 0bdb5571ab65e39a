"""Finds packages in folders.

A package is a folder with a package.xml, or with definitions in msg/, srv/ or action/. In one with a package.xml these
folders may lie in others that group them (`planning/msg/`) or hold such (`msg/planning/`), as rosidl takes them.
Folders above packages are searched to any depth, in order of name; COLCON_IGNORE, AMENT_IGNORE or CATKIN_IGNORE takes a
folder out, and rospack_nosubdirs all that is below it.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from shmgen.core import files
from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import TypeName
from shmgen.definitions.catalogue import Catalogue, Definition, Package, package_of
from shmgen.definitions.parser import SECTIONS
from shmgen.definitions.tokens import Dialect

LARGEST_FILE = 2**19
"""Bytes. The largest definition known to us, px4_msgs/VehicleCommand, has 24 KiB."""


def catalogue(folder: Path, relative_to: Path, report: Report) -> Catalogue:
    """Every package in and below `folder`. SHM001 where there are too many folders to look at."""
    found: dict[str, tuple[Package, ...]] = {}
    packages = _packages(folder, relative_to)
    if packages is None:
        hint = "name the folder that your packages are in"
        said = f"more than {_MOST_FOLDERS:,} folders are in and below it"
        report.error("SHM001", said, Span(shorten(folder, relative_to)), hint=hint)
    for package in packages or ():
        held = tuple(other for other in found.get(package.name, ()) if other.definitions)
        if package.definitions or not held:  # one of programs alone is not meant
            found[package.name] = (*held, package)
    return found


def package_around(file: Path, relative_to: Path) -> Package | None:
    """The package that a definition given by its path belongs to; that file alone, if it lies in no package."""
    folder = Path(os.path.abspath(file)).parent
    kind = kind_of(file)
    section = _section(folder)
    package = _package(_root(section.parent) if section else folder, relative_to)
    if package is None:
        return None
    name = package.name
    given = _definition(file, TypeName(name, kind, file.stem), relative_to)
    siblings = {} if section else _loose(folder, name, relative_to)
    held = {**siblings, **package.definitions, **dict.fromkeys(given.messages, given)}
    return Package(name, package.place, held, package.dialect)


def _section(folder: Path) -> Path | None:
    """The msg/, srv/ or action/ that a definition lies in: its own or, if there is a package.xml, one above."""
    above = (place for place in (folder, *folder.parents[:_DEEPEST_GROUP]) if place.name in SECTIONS)
    return next((it for it in above if it == folder or (_root(it.parent) / "package.xml").is_file()), None)


def _root(folder: Path) -> Path:
    """The package around a folder that holds msg/, srv/ or action/: itself, unless it only groups those."""
    above = [folder, *folder.parents[:_DEEPEST_GROUP]]
    return next((place for place in above if (place / "package.xml").is_file()), folder)


_DEEPEST_GROUP = 3


def kind_of(file: Path) -> str:
    """msg, srv or action; of an .idl the folder says it."""
    section = _section(Path(os.path.abspath(file)).parent)
    return (section.name if section else "msg") if file.suffix == ".idl" else file.suffix.removeprefix(".")


def read(definition: Definition, report: Report) -> str | None:
    """The text, without a byte order mark; None with SHM001 or SHM002 in the report."""
    if isinstance(definition.content, str):
        return definition.content
    nowhere = Span(definition.path)
    try:
        if not definition.content.is_file():
            what = "not a file" if definition.content.exists() else "no such file"
            report.error("SHM001", what, nowhere)
            return None
        with definition.content.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except OSError as error:
        report.error("SHM001", f"cannot read: {error.strerror}", nowhere)
        return None
    if len(data) > LARGEST_FILE:
        report.error("SHM001", f"larger than {LARGEST_FILE // 1024} KiB, so hardly a definition", nowhere)
        return None
    try:
        return data.decode().removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}")
    except UnicodeDecodeError as error:
        before = data[: error.start].decode()
        line = before.count("\n") + 1
        column = len(before) - before.rfind("\n")
        culprit = f"byte 0x{data[error.start]:02X} is not UTF-8"
        report.error("SHM002", culprit, Span(definition.path, line, column, 1), hint="save the file as UTF-8")
        return None


_IGNORED = ("COLCON_IGNORE", "AMENT_IGNORE", "CATKIN_IGNORE")
_PACKAGE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_NAME_IN_XML = re.compile(rb"<name\s*>\s*([A-Za-z0-9_-]+)\s*</name\s*>")
_BUILD_TOOL = re.compile(rb"<(?:buildtool_depend|build_type)\b[^<>]*>\s*([A-Za-z0-9_-]+)")


_MOST_FOLDERS = 100_000
"""That are searched for packages; a workspace with all of ROS has some thousand."""


def _packages(folder: Path, relative_to: Path) -> list[Package] | None:
    """Depth first, without recursion; a folder reached twice over links counts once. None where there are too many."""
    found: list[Package] = []
    seen: set[tuple[int, int]] = set()
    waiting = [folder]
    while waiting:
        here = waiting.pop()
        try:
            status = here.stat()
            entries = sorted(here.iterdir())
        except OSError:
            continue
        names = {entry.name for entry in entries}
        if (status.st_dev, status.st_ino) in seen or not names.isdisjoint(_IGNORED):
            continue
        seen.add((status.st_dev, status.st_ino))
        if len(seen) > _MOST_FOLDERS:
            return None
        if "package.xml" in names or any(_files(here / kind, kind) for kind in SECTIONS if kind in names):
            package = _package(here, relative_to)
            if package is not None:
                found.append(package)
            continue
        if "rospack_nosubdirs" in names:
            continue
        waiting += [entry for entry in reversed(entries) if entry.name[0] != "." and os.path.isdir(entry)]
    return found


def _package(root: Path, relative_to: Path) -> Package | None:
    """None where neither package.xml nor the folder's own name can be a package's."""
    manifest = _manifest(root)
    said = _NAME_IN_XML.search(manifest)
    name = said[1].decode() if said else root.name or Path(os.path.abspath(root)).name
    if not _PACKAGE_NAME.fullmatch(name):
        return None
    definitions = [
        _definition(file, TypeName(name, kind, file.stem), relative_to)
        for kind in SECTIONS
        for place in (*_groups(root, bool(manifest)), root)  # of two of one name the one at the top counts
        for file in _files(place / kind, kind, with_groups=bool(manifest))
    ]
    return package_of(name, shorten(root, relative_to), definitions, _dialect(manifest))


def _groups(root: Path, has_manifest: bool) -> list[Path]:
    """The folders in a package that group its definitions: they hold a msg/, srv/ or action/."""
    found: list[Path] = []
    for here, folders, others in os.walk(root) if has_manifest else ():
        if here != str(root) and not {"package.xml", *_IGNORED}.isdisjoint(others):
            folders.clear()
            continue
        if here != str(root) and not set(SECTIONS).isdisjoint(folders):
            found.append(Path(here))
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name not in SECTIONS)
    return found


def _loose(folder: Path, name: str, relative_to: Path) -> dict[TypeName, Definition]:
    """The .msg files next to each other in a folder that is no msg/."""
    definitions = [_definition(file, TypeName(name, "msg", file.stem), relative_to) for file in _files(folder, "msg")]
    return {message: definition for definition in definitions for message in definition.messages}


def _files(folder: Path, kind: str, *, with_groups: bool = False) -> list[Path]:
    """The definitions of a kind; of a message that is there twice not the .idl, which ROS has made of the other.

    `with_groups`: those in folders below it too.
    """
    found: dict[str, Path] = {}
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        return []
    others = [entry for entry in entries if entry.suffix not in (f".{kind}", ".idl") and entry.name[0] != "."]
    groups = [entry for entry in others if not entry.is_symlink()] if with_groups else ()
    below = [file for group in groups for file in _files(group, kind, with_groups=True)]
    for file in (*below, *entries):  # of two of one name the one at the top counts
        if file.suffix == f".{kind}" or (file.suffix == ".idl" and file.stem not in found):
            found[file.stem] = file
    return [found[stem] for stem in sorted(found)]


def _definition(file: Path, name: TypeName, relative_to: Path) -> Definition:
    shortened = shorten(file, relative_to)
    # Generated files print the origin, so it must be the same on every machine.
    origin = shortened if not os.path.isabs(shortened) else f"{name.package}/{name.kind}/{file.name}"
    return Definition(name, shortened, origin, file)


def shorten(path: Path, relative_to: Path) -> str:
    """Relative where that needs no `..`, else absolute; on one line, whatever is in the name."""
    absolute, start = os.path.abspath(path), os.path.abspath(relative_to)
    text = os.path.relpath(absolute, start) if Path(absolute).is_relative_to(start) else absolute
    text = text.replace(os.sep, "/")  # on Windows too, so that what is generated is the same
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def _manifest(root: Path) -> bytes:
    """package.xml without its comments; empty where there is none."""
    try:
        with files.opened(root / "package.xml") as file:
            first, *others = file.read(LARGEST_FILE).split(b"<!--")
    except OSError:
        return b""
    return first + b"".join(other.partition(b"-->")[2] for other in others)


def _dialect(manifest: bytes) -> Dialect | None:
    """By the build tool: catkin is that of ROS 1, ament that of ROS 2. None where neither is named, or both."""
    tools = {tool.partition(b"_")[0] for tool in _BUILD_TOOL.findall(manifest)}
    if (b"catkin" in tools) == (not tools.isdisjoint((b"ament", b"rosidl"))):
        return None
    return "ros1" if b"catkin" in tools else "ros2"
