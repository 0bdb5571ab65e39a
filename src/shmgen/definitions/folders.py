"""Find the packages of definitions in a folder of the user.

A package is a folder with a package.xml, or with definitions in msg/, srv/ or action/. In a package with a package.xml,
further folders may group definitions as rosidl allows: `planning/msg/` or `msg/planning/`. Folders above packages are
searched to any depth, in order of name. A file COLCON_IGNORE, AMENT_IGNORE or CATKIN_IGNORE excludes its folder. A
folder with a file rospack_nosubdirs is searched without its subfolders.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from shmgen.core import files
from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import TypeName
from shmgen.definitions.catalogue import SECTIONS, Catalogue, Definition, Package, package_of
from shmgen.definitions.tokens import Dialect

LARGEST_FILE = 2**19
"""The largest size of a definition file in bytes. The largest known file, px4_msgs/VehicleCommand, has 24 KiB."""


def catalogue(folder: Path, relative_to: Path, report: Report) -> Catalogue:
    """Return all packages in and below `folder`. Report SHM001 if there are too many folders to search."""
    packages_by_name: dict[str, tuple[Package, ...]] = {}
    for package in _packages(folder, relative_to, report):
        with_definitions = tuple(other for other in packages_by_name.get(package.name, ()) if other.definitions)
        if package.definitions or not with_definitions:  # ignore a package without definitions if another has some
            packages_by_name[package.name] = (*with_definitions, package)
    return packages_by_name


def package_around(file: Path, relative_to: Path) -> tuple[Package, Definition] | None:
    """Return the package that contains a definition file, and the definition in the file.

    If no package contains the file, its folder is the package. The folder also decides the kind of an .idl file; msg is
    the default. Return None if the package or the folder has no valid package name.
    """
    folder = Path(os.path.abspath(file)).parent
    section = _section(folder)
    kind = file.suffix.removeprefix(".")
    if kind == "idl":
        kind = section.name if section else "msg"
    package = package_at(_root(section.parent) if section else folder, relative_to)
    if package is None:
        return None
    siblings = () if section else _files(folder, "msg")
    definitions = [definition_of(sibling, package.name, "msg", relative_to) for sibling in siblings]
    definition = definition_of(file, package.name, kind, relative_to)
    definitions += [*package.definitions.values(), definition]
    return package_of(package.name, package.place, definitions, package.dialect), definition


def _section(folder: Path) -> Path | None:
    """Return the folder called msg/, srv/ or action/ that a definition in `folder` belongs to, or None.

    The result is `folder` itself or, in a package with a package.xml, a folder above `folder`.
    """
    above = (place for place in (folder, *folder.parents[:_DEEPEST_GROUP]) if place.name in SECTIONS)
    return next((it for it in above if it == folder or (_root(it.parent) / "package.xml").is_file()), None)


def _root(folder: Path) -> Path:
    """Return the root of the package that contains `folder`, a folder with a subfolder msg/, srv/ or action/.

    The root is the nearest folder with a package.xml, or `folder` itself if there is none.
    """
    above = [folder, *folder.parents[:_DEEPEST_GROUP]]
    return next((place for place in above if (place / "package.xml").is_file()), folder)


_DEEPEST_GROUP = 3


def read(definition: Definition, report: Report) -> str | None:
    """Return the text of a definition, without a byte order mark.

    If the file cannot be read, report SHM001 and return None. If the file is not UTF-8, report SHM002 and return None.
    """
    if isinstance(definition.content, str):
        return definition.content
    problem, data = "", b""
    try:
        if definition.content.is_file():
            with definition.content.open("rb") as file:
                data = file.read(LARGEST_FILE + 1)
        else:
            problem = "not a file" if definition.content.exists() else "no such file"
    except OSError as error:
        problem = f"cannot read: {error.strerror}"
    if len(data) > LARGEST_FILE:
        problem = f"larger than {LARGEST_FILE // 1024} KiB, the limit of a definition"
    if problem:
        report.error("SHM001", problem, Span(definition.path))
        return None
    try:
        return data.decode().removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}")
    except UnicodeDecodeError as error:
        before = data[: error.start].decode()
        place = Span(definition.path, before.count("\n") + 1, len(before) - before.rfind("\n"), 1)
        report.error("SHM002", f"byte 0x{data[error.start]:02X} is not UTF-8", place, hint="save the file as UTF-8")
        return None


_IGNORED = ("COLCON_IGNORE", "AMENT_IGNORE", "CATKIN_IGNORE")
_PACKAGE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_NAME_IN_XML = re.compile(rb"<name\s*>\s*([A-Za-z0-9_-]+)\s*</name\s*>")
_BUILD_TOOL = re.compile(rb"<(?:buildtool_depend|build_type)\b[^<>]*>\s*([A-Za-z0-9_-]+)")


_MOST_FOLDERS = 100_000
"""The largest number of folders to search for packages. A workspace with all of ROS has some thousand."""


def _packages(folder: Path, relative_to: Path, report: Report) -> list[Package]:
    """Return the packages in and below a folder. If there are too many folders, report SHM001 and return no package.

    The search is depth first, without recursion. A folder reached twice through links counts once.
    """
    packages: list[Package] = []
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
            problem = f"more than {_MOST_FOLDERS:,} folders to search"
            hint = "give the folder that contains your packages"
            report.error("SHM001", problem, Span(shorten(folder, relative_to)), hint=hint)
            return []
        if "package.xml" in names or any(_files(here / kind, kind) for kind in SECTIONS if kind in names):
            package = package_at(here, relative_to)
            if package is not None:
                packages.append(package)
            continue
        if "rospack_nosubdirs" in names:
            continue
        waiting += [entry for entry in reversed(entries) if entry.name[0] != "." and os.path.isdir(entry)]
    return packages


def package_at(root: Path, relative_to: Path) -> Package | None:
    """Return the package in `root`, or None if package.xml and the folder give no valid package name."""
    manifest = _manifest(root)
    name_element = _NAME_IN_XML.search(manifest)
    name = name_element[1].decode() if name_element else root.name or Path(os.path.abspath(root)).name
    if not _PACKAGE_NAME.fullmatch(name):
        return None
    definitions = [
        definition_of(file, name, kind, relative_to)
        for kind in SECTIONS
        for place in (*_groups(root, bool(manifest)), root)  # if a name occurs twice, the definition in root wins
        for file in _files(place / kind, kind, with_groups=bool(manifest))
    ]
    return package_of(name, shorten(root, relative_to), definitions, _dialect(manifest))


def _groups(root: Path, has_manifest: bool) -> list[Path]:
    """Return the subfolders of a package that contain msg/, srv/ or action/. A package without a manifest has none."""
    groups: list[Path] = []
    for here, folders, others in os.walk(root) if has_manifest else ():
        if here != str(root) and not {"package.xml", *_IGNORED}.isdisjoint(others):
            folders.clear()
            continue
        if here != str(root) and not set(SECTIONS).isdisjoint(folders):
            groups.append(Path(here))
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name not in SECTIONS)
    return groups


def _files(folder: Path, kind: str, *, with_groups: bool = False) -> list[Path]:
    """Return the definition files of a kind (msg, srv or action) in a folder.

    If `with_groups` is true, files in subfolders are included. If `Foo.idl` and `Foo.msg` both exist, `Foo.idl` is
    omitted: ROS generated it from `Foo.msg`.
    """
    by_stem: dict[str, Path] = {}
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        return []
    others = [entry for entry in entries if entry.suffix not in (f".{kind}", ".idl") and entry.name[0] != "."]
    groups = [entry for entry in others if not entry.is_symlink()] if with_groups else ()
    below = [file for group in groups for file in _files(group, kind, with_groups=True)]
    for file in (*below, *entries):  # if a name occurs twice, the file at the top wins
        if file.suffix == f".{kind}" or (file.suffix == ".idl" and file.stem not in by_stem):
            by_stem[file.stem] = file
    return [by_stem[stem] for stem in sorted(by_stem)]


def definition_of(file: Path, package: str, kind: str, relative_to: Path) -> Definition:
    """Return the definition in a file of the kind msg, srv or action, which belongs to the package `package`."""
    shortened = shorten(file, relative_to)
    # Generated files print the origin, so the origin must be the same on every machine.
    origin = shortened if not os.path.isabs(shortened) else f"{package}/{kind}/{file.name}"
    return Definition(TypeName(package, kind, file.stem), shortened, origin, file)


def shorten(path: Path, relative_to: Path) -> str:
    """Return a path for diagnostics: relative if the file is in or below `relative_to`, otherwise absolute.

    Unprintable characters are replaced.
    """
    absolute, start = os.path.abspath(path), os.path.abspath(relative_to)
    text = os.path.relpath(absolute, start) if Path(absolute).is_relative_to(start) else absolute
    text = text.replace(os.sep, "/")  # also on Windows, so that generated files are the same
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def _manifest(root: Path) -> bytes:
    """Return the text of package.xml without comments, or `b""` if there is no package.xml."""
    try:
        with files.open_file(root / "package.xml") as file:
            first, *others = file.read(LARGEST_FILE).split(b"<!--")
    except OSError:
        return b""
    return first + b"".join(other.partition(b"-->")[2] for other in others)


def _dialect(manifest: bytes) -> Dialect | None:
    """Return the dialect of a package from the build tool in its package.xml.

    The build tool catkin means ROS 1; ament or rosidl means ROS 2. Return None if the package.xml names no build tool,
    or build tools of both.
    """
    tools = {tool.partition(b"_")[0] for tool in _BUILD_TOOL.findall(manifest)}
    if (b"catkin" in tools) == (not tools.isdisjoint((b"ament", b"rosidl"))):
        return None
    return "ros1" if b"catkin" in tools else "ros2"
