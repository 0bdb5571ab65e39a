"""Find the packages that a sourced ROS itself would find in this shell.

Each prefix of ROS 2 has an index of the packages with definitions, in
`share/ament_index/resource_index/rosidl_interfaces`. ROS 1 has no index, so its package folders are searched, as
rospack searches them. /usr/share is always searched for packages of ROS 1, because Debian installs them there.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from shmgen.core.diagnostics import Report, Span
from shmgen.definitions import folders
from shmgen.definitions.catalogue import SECTIONS, Catalogue, Package, package_of
from shmgen.definitions.tokens import Dialect

DEBIAN = Path("/usr/share")
"""The folder in which Debian's packages such as ros-std-msgs install <package>/msg, without a package.xml."""


def dialect(variables: Mapping[str, str]) -> Dialect:
    """Return the dialect of the ROS that is sourced in this shell.

    If both ROS 1 and ROS 2 are sourced, ROS_VERSION names the one that was sourced last.
    """
    if variables.get("ROS_VERSION") in ("1", "2"):
        return "ros1" if variables["ROS_VERSION"] == "1" else "ros2"
    return "ros2" if variables.get("AMENT_PREFIX_PATH") else "ros1"


def places(variables: Mapping[str, str]) -> list[Path]:
    """Return the existing folders in which a sourced ROS has packages, in order of precedence.

    For ROS 2, the folders are prefixes. For ROS 1, they are package folders.
    """
    if dialect(variables) == "ros2":
        existing = [place for place in _paths(variables, "AMENT_PREFIX_PATH") if (place / _INDEX).is_dir()]
    else:
        existing = [place for place in _paths(variables, "ROS_PACKAGE_PATH") if place.is_dir()]
        existing += [DEBIAN] if (DEBIAN / "std_msgs" / "msg").is_dir() and DEBIAN not in existing else []
    return list(dict.fromkeys(existing))


def catalogue(variables: Mapping[str, str], report: Report) -> Catalogue:
    """Return the packages of the sourced ROS.

    If several folders contain the same package, all its definitions come from the first of these folders. Raises
    Rejected (SHM506) if no packages are found.
    """
    ros = dialect(variables)
    all_packages: dict[str, tuple[Package, ...]] = {}
    for place in places(variables):
        if ros == "ros2":
            packages: Catalogue = {package.name: (package,) for package in _indexed(place)}
        elif place == DEBIAN:
            packages = {package.name: (package,) for package in _loose(place)}
        else:
            packages = folders.catalogue(place, _NOWHERE, report)
        installed = {name: tuple(_installed(package, ros) for package in several) for name, several in packages.items()}
        all_packages = {**installed, **all_packages}
    if not all_packages:
        name, distribution = ("AMENT_PREFIX_PATH", "jazzy") if ros == "ros2" else ("ROS_PACKAGE_PATH", "noetic")
        value = variables.get(name)
        if not any(map(variables.get, ("ROS_VERSION", "AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"))):
            distribution = "jazzy"  # no variable names a ROS; most users have ROS 2
        setup = f"/opt/ros/{distribution}/setup.bash"
        hint = f"type `source {setup}`, or the setup.bash of your workspace, and repeat the command"
        hint += '\nwithout ROS, set source = "jazzy" in shmgen.toml to use built-in definitions'
        why = (
            f"{name} is {value!r}, but its folders contain no messages" if value else "no ROS is sourced in this shell"
        )
        report.error("SHM506", why, Span('source = "env"'), hint=hint)
        report.stop_if_any()
    return all_packages


_NOWHERE = Path(os.devnull)
"""A path without files. Paths shortened relative to this path stay absolute."""
_INDEX = "share/ament_index/resource_index/rosidl_interfaces"
_LARGEST_INDEX = 2**20
# Skip names with an underscore, as `ros2 interface` does: ROS 2 generates them from services and actions.
_INTERFACE = re.compile(r"(msg|srv|action)/([A-Za-z][A-Za-z0-9]*)\.(msg|srv|action|idl)")


def _paths(variables: Mapping[str, str], name: str) -> list[Path]:
    return [Path(entry) for entry in variables.get(name, "").split(os.pathsep) if os.path.isabs(entry)]


def _indexed(prefix: Path) -> Iterable[Package]:
    """Yield the packages that the ROS 2 index of a prefix lists."""
    for entry in sorted((prefix / _INDEX).iterdir()):
        root = prefix / "share" / entry.name
        try:
            with entry.open(encoding="utf-8", errors="replace") as file:
                lines = file.read(_LARGEST_INDEX).split()
        except OSError:
            continue
        files: dict[tuple[str, str], Path] = {}
        for kind, stem, ending in (match.groups() for line in lines if (match := _INTERFACE.fullmatch(line))):
            if ending == kind or (ending == "idl" and (kind, stem) not in files):
                files[kind, stem] = root / kind / f"{stem}.{ending}"
        definitions = [folders.definition_of(file, entry.name, kind, _NOWHERE) for (kind, _), file in files.items()]
        yield package_of(entry.name, folders.shorten(root, _NOWHERE), definitions)


def _loose(folder: Path) -> Iterable[Package]:
    """Yield a package for each subfolder with msg/, srv/ or action/. No package.xml is needed."""
    roots = {file.parents[1] for kind in SECTIONS for file in folder.glob(f"*/{kind}/*.{kind}")}
    return filter(None, (folders.package_at(root, _NOWHERE) for root in sorted(roots)))


def _installed(package: Package, dialect: Dialect) -> Package:
    """Return a package marked as a package of ROS 1 or ROS 2.

    The mark sets the dialect of the package, and the origin of each definition, which generated files print. The origin
    contains neither the folder nor the distribution, so that a definition gives the same output in every installation.
    """
    mark = f" of ROS {dialect[-1]}"
    definitions = {name: one._replace(origin=one.origin + mark) for name, one in package.definitions.items()}
    return package._replace(definitions=definitions, dialect=dialect)
