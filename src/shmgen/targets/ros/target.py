"""Turns the topics and services of shmgen.toml into a ROS package that starts `shmgen bridge` for them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen.model import Layouts, Message, Output, TypeName

_PARTS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}


class Package(NamedTuple):
    """`module` is the Python module of the ROS 2 package; `dependencies` are packages of messages."""

    name: str
    version: str
    node: str
    dependencies: tuple[str, ...]


class Text(NamedTuple):
    """A file that is handed on as it is."""

    text: str


def plan(
    ros: str, package: Package, configuration: str, layouts: Layouts, carried: Sequence[TypeName]
) -> Iterator[Output]:
    """`ros2/<name>/` for ament_python, `ros1/<name>/` for catkin; `ros` is "ros1" or "ros2".

    `configuration` is the text of shmgen.toml; its `path` becomes a folder of the package, which gets the definitions.
    """
    root = f"{ros}/{package.name}"
    view = package._replace(dependencies=tuple(sorted({name.package for name in carried})))
    for file, template in _FILES[ros]:
        yield Output(f"{root}/{file.format(package.name)}", f"ros/{template}", view)
    files = dict(_definitions(layouts))
    yield Output(f"{root}/config/shmgen.toml", "ros/text.j2", Text(_relocated(configuration, bool(files))))
    for path, text in files.items():
        yield Output(f"{root}/config/msgs/{path}", "ros/text.j2", Text(text.rstrip("\n")))


def default_name(package: str) -> str:
    """`shm_msgs` -> `shm_msgs_bridge`, within REP 144."""
    words = re.findall("[a-z0-9]+", package.lower())
    return "_".join([*words, "bridge"])


_FILES = {
    "ros1": (
        ("package.xml", "ros1_package.xml.j2"),
        ("CMakeLists.txt", "CMakeLists.txt.j2"),
        ("setup.py", "ros1_setup.py.j2"),
        ("src/{}/__init__.py", "bridge.py.j2"),
        ("scripts/bridge", "script.j2"),
        ("launch/bridge.launch", "bridge.launch.j2"),
    ),
    "ros2": (
        ("package.xml", "ros2_package.xml.j2"),
        ("setup.py", "ros2_setup.py.j2"),
        ("setup.cfg", "setup.cfg.j2"),
        ("resource/{}", "empty.j2"),
        ("{}/__init__.py", "bridge.py.j2"),
        ("launch/bridge.launch.py", "bridge.launch.py.j2"),
        ("config/bridge.yaml", "bridge.yaml.j2"),
    ),
}
_PATH = re.compile(r"^path\s*=\s*\[[^\]]*\].*\n?", re.MULTILINE)


def _relocated(configuration: str, has_definitions: bool) -> str:
    """The same, but that `path` is where the package has the definitions."""
    top, table, rest = re.match(r"(?s)(.*?)(^\[|\Z)(.*)", configuration, re.MULTILINE).groups()  # type: ignore[union-attr]
    line = 'path = ["msgs"]  # the definitions, copied beside this file\n' if has_definitions else ""
    return (line + _PATH.sub("", top) + table + rest).rstrip("\n")


def _definitions(layouts: Layouts) -> Iterator[tuple[str, str]]:
    """Path and text of each file that is not of a built-in store."""
    found: dict[tuple[str, str, str], dict[str, Message]] = {}
    for name, layout in layouts.items():
        for part in _PARTS[name.kind]:
            if name.name.endswith(part) and not layout.message.origin.startswith("built-in"):
                bare = name.name.removesuffix(part)
                found.setdefault((name.package, name.kind, bare), {})[part] = layout.message
    for (package, kind, bare), parts in sorted(found.items()):
        if len(parts) == len(_PARTS[kind]):
            texts = dict.fromkeys(parts[part].text.rstrip("\n") for part in _PARTS[kind])
            yield f"{package}/{kind}/{bare}.{kind}", "\n---\n".join(texts) + "\n"
