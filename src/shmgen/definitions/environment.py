"""Finds packages in the environment of a sourced ROS: those that ROS itself would find in this shell.

ROS 2 has an index of interfaces in each prefix, `share/ament_index/resource_index/rosidl_interfaces` (ament's
resource index). ROS 1 has folders that rospack crawls. Debian's ROS 1 lies in /usr/share, and nobody sources it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import TypeName
from shmgen.definitions import folders
from shmgen.definitions.catalogue import Catalogue, Definition, Package, package_of
from shmgen.definitions.parser import SECTIONS
from shmgen.definitions.tokens import Dialect

DEBIAN = Path("/usr/share")
"""Where Debian's packages ros-std-msgs and others put <package>/msg, without a package.xml."""


def dialect(variables: Mapping[str, str]) -> Dialect:
    """Which ROS this shell is of. Both may be sourced, as a bridge needs it: then the last one, ROS_VERSION."""
    if variables.get("ROS_VERSION") in ("1", "2"):
        return "ros1" if variables["ROS_VERSION"] == "1" else "ros2"
    return "ros2" if variables.get("AMENT_PREFIX_PATH") else "ros1"


def places(variables: Mapping[str, str]) -> list[Path]:
    """Prefixes of ROS 2, or folders with packages of ROS 1, in the order in which they win; those that exist."""
    if dialect(variables) == "ros2":
        found = [place for place in _paths(variables, "AMENT_PREFIX_PATH") if (place / _INDEX).is_dir()]
    else:
        found = [place for place in _paths(variables, "ROS_PACKAGE_PATH") if place.is_dir()]
        found += [DEBIAN] if (DEBIAN / "std_msgs" / "msg").is_dir() and DEBIAN not in found else []
    return list(dict.fromkeys(found))


def catalogue(variables: Mapping[str, str], report: Report) -> Catalogue:
    """A package comes whole from the first place that has it. Raises Rejected: SHM506, where no ROS is found."""
    ros2 = dialect(variables) == "ros2"
    found: dict[str, tuple[Package, ...]] = {}
    for place in places(variables):
        if ros2:
            packages: Catalogue = {package.name: (package,) for package in _indexed(place)}
        elif place == DEBIAN:
            packages = {package.name: (package,) for package in _loose(place)}
        else:
            crawled = folders.catalogue(place, _NOWHERE, report)
            packages = {name: tuple(_of_ros1(package) for package in several) for name, several in crawled.items()}
        found = {**packages, **found}
    if not found:
        name, distribution = ("AMENT_PREFIX_PATH", "jazzy") if ros2 else ("ROS_PACKAGE_PATH", "noetic")
        value = variables.get(name)
        if not any(map(variables.get, ("ROS_VERSION", "AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"))):
            distribution = "jazzy"  # which ROS is meant cannot be known; most are of this kind
        hint = (
            f"type `source /opt/ros/{distribution}/setup.bash`, or that of your workspace, and run again in that shell"
        )
        hint += '\nwithout a ROS: set source to a built-in store, such as "jazzy", in shmgen.toml'
        why = f"{name} is {value!r}, and no messages are there" if value else "no ROS is sourced in this shell"
        report.error("SHM506", why, Span('source = "env"'), hint=hint)
        report.stop_if_any()
    return found


_NOWHERE = Path(os.devnull)
"""Paths are shown relative to this, so whole."""
_INDEX = "share/ament_index/resource_index/rosidl_interfaces"
_LARGEST_INDEX = 2**20
# Names with an underscore are what ROS 2 has made of services and actions itself, as `ros2 interface` has it.
_INTERFACE = re.compile(r"(msg|srv|action)/([A-Za-z][A-Za-z0-9]*)\.(msg|srv|action|idl)")


def _paths(variables: Mapping[str, str], name: str) -> list[Path]:
    return [Path(entry) for entry in variables.get(name, "").split(os.pathsep) if os.path.isabs(entry)]


def _indexed(prefix: Path) -> Iterable[Package]:
    """As the index of one prefix has them."""
    for entry in sorted((prefix / _INDEX).iterdir()):
        root = prefix / "share" / entry.name
        try:
            with entry.open(encoding="utf-8", errors="replace") as file:
                lines = file.read(_LARGEST_INDEX).split()
        except OSError:
            continue
        files: dict[tuple[str, str], Path] = {}
        for kind, stem, ending in (found.groups() for line in lines if (found := _INTERFACE.fullmatch(line))):
            if ending == kind or (ending == "idl" and (kind, stem) not in files):
                files[kind, stem] = root / kind / f"{stem}.{ending}"
        yield _package(entry.name, root, files.values(), "ros2")


def _loose(folder: Path) -> Iterable[Package]:
    """Folders that hold msg/, srv/ or action/, and nothing that says they are packages."""
    files: dict[str, list[Path]] = {}
    for kind in SECTIONS:
        for file in sorted(folder.glob(f"*/{kind}/*.{kind}")):
            files.setdefault(file.parts[-3], []).append(file)
    for name in sorted(files):
        yield _package(name, folder / name, files[name], "ros1")


def _of_ros1(package: Package) -> Package:
    """What a crawl found, said to come from ROS."""
    held = {name: replace(one, origin=f"{one.origin} of ROS 1") for name, one in package.definitions.items()}
    return Package(package.name, package.place, held, "ros1")


def _package(name: str, root: Path, files: Iterable[Path], dialect: Dialect) -> Package:
    """The origin names no prefix and no distribution: one text gives one output, wherever it lies."""
    definitions = [
        Definition(
            TypeName(name, file.parent.name, file.stem),
            folders.shorten(file, _NOWHERE),
            f"{name}/{file.parent.name}/{file.name} of ROS {dialect[-1]}",
            file,
        )
        for file in files
    ]
    return package_of(name, folders.shorten(root, _NOWHERE), definitions, dialect)
