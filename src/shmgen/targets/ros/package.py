"""Writes a ROS package that starts `shmgen bridge` for the topics and services of shmgen.toml."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

from shmgen.core import toml
from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Layouts, Message, Output
from shmgen.targets import Job

_PARTS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}


class Package(NamedTuple):
    """`dependencies` are packages of messages."""

    name: str
    version: str
    node: str
    dependencies: tuple[str, ...]


class Text(NamedTuple):
    """A file that is handed on as it is."""

    text: str


def described(target: str, job: Job, report: Report) -> Package | None:
    """The package of a target. Reports SHM504 where there is nothing to carry."""
    carried = {used.type.package for used in job.uses}
    if not carried:
        hint = "list [[topics]] or [[services]] in shmgen.toml"
        report.error("SHM504", f"the target {target} has nothing to carry", Span("shmgen.toml"), hint=hint)
        return None
    options = job.options
    version = options.distribution.partition(" ")[2]
    return Package(
        options.ros_package or default_name(job.package),
        version if re.fullmatch(r"\d+\.\d+\.\d+", version) else "0.1.0",
        options.node,
        tuple(sorted(carried)),
    )


class Starting(NamedTuple):
    """A target whose package starts `shmgen bridge`. `files` are the paths in it, each with its template.

    The user's names stand in copies of the definitions alone.
    """

    key: str
    files: tuple[tuple[str, str], ...]
    NAMES: None = None

    def plan(self, job: Job, report: Report) -> Iterator[Output]:
        """`<key>/<name>/`. Reports SHM504 where there is nothing to carry.

        What the bridge needs of shmgen.toml comes along; `path` becomes a folder of the package, with the definitions.
        """
        package = described(self.key, job, report)
        if package is None:
            return
        root = f"{self.key}/{package.name}"
        for file, template in self.files:
            yield Output(f"{root}/{file.format(package.name)}", f"ros/{template}", package)
        definitions = dict(_definitions(job.layouts))
        said = {key: value for key, value in job.options.configuration.items() if key not in _ELSEWHERE}
        configuration = toml.dumps({"path": ["msgs"], **said} if definitions else said)
        yield Output(f"{root}/config/shmgen.toml", "ros/shmgen.toml.j2", Text(configuration.rstrip("\n")))
        for path, text in definitions.items():
            yield Output(f"{root}/config/msgs/{path}", "ros/text.j2", Text(text.rstrip("\n")))


ROS1 = Starting(
    "ros1",
    (
        ("package.xml", "ros1_package.xml.j2"),
        ("CMakeLists.txt", "CMakeLists.txt.j2"),
        ("setup.py", "ros1_setup.py.j2"),
        ("src/{}/__init__.py", "bridge.py.j2"),
        ("scripts/bridge", "script.j2"),
        ("launch/bridge.launch", "bridge.launch.j2"),
    ),
)
"""A catkin package."""
ROS2 = Starting(
    "ros2",
    (
        ("package.xml", "ros2_package.xml.j2"),
        ("setup.py", "ros2_setup.py.j2"),
        ("setup.cfg", "setup.cfg.j2"),
        ("resource/{}", "empty.j2"),
        ("{}/__init__.py", "bridge.py.j2"),
        ("launch/bridge.launch.py", "bridge.launch.py.j2"),
        ("config/bridge.yaml", "bridge.yaml.j2"),
    ),
)
"""An ament_python package."""


def beside(root: str, *targets: Iterator[Output]) -> Iterator[Output]:
    """What other targets write, below `root`/include."""
    for output in chain(*targets):
        yield replace(output, path=f"{root}/include/{output.path.partition('/')[2]}")


def default_name(package: str) -> str:
    """`shm_msgs` -> `shm_msgs_bridge`, within REP 144."""
    words = re.findall("[a-z0-9]+", package.lower())
    return "_".join([*words, "bridge"])


_ELSEWHERE = ("path", "messages", "targets")
"""Folders and files of the project, and what only `generate` asks for."""


def _definitions(layouts: Layouts) -> Iterator[tuple[str, str]]:
    """Path and text of each file that is not of a built-in store."""
    found: dict[tuple[str, str, str], dict[str, Message]] = {}
    for name, layout in layouts.items():
        for part in _PARTS[name.kind]:
            if name.name.endswith(part) and not layout.message.origin.startswith("built-in"):
                bare = name.name.removesuffix(part)
                found.setdefault((name.package, name.kind, bare), {})[part] = layout.message
    for (package, kind, bare), parts in sorted(found.items()):
        if parts.keys() != set(_PARTS[kind]):
            continue
        first, *others = (parts[part] for part in _PARTS[kind])
        if first.span.path.endswith(".idl"):  # each part has the text of the whole file
            yield f"{package}/{kind}/{bare}.idl", first.text
        else:
            yield f"{package}/{kind}/{bare}.{kind}", "\n---\n".join(part.text.rstrip("\n") for part in (first, *others))
