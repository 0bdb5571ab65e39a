"""Generate a ROS package that starts `shmgen bridge` for the topics and services of shmgen.toml."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

from shmgen.core import toml
from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Layouts, Message, Output
from shmgen.targets import Job, Text

_PARTS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}


class Package(NamedTuple):
    """The template data for a ROS package. `dependencies` are the ROS packages whose messages the bridge transfers."""

    name: str
    version: str
    node: str
    dependencies: tuple[str, ...]


def described(target: str, job: Job, report: Report) -> Package | None:
    """Return the name, version and dependencies of the ROS package that a target generates.

    If shmgen.toml has no topic, service or action, report SHM504 and return None.
    """
    carried = {used.type.package for used in job.uses}
    if not carried:
        hint = "add [[topics]], [[services]] or [[actions]] to shmgen.toml"
        report.error("SHM504", f"the target {target} needs a topic, service or action", Span("shmgen.toml"), hint=hint)
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
    """A target that generates a ROS package which starts `shmgen bridge`.

    `files` maps each path in the package to its template, as pairs. `NAMES` is None, because only the copied
    definitions contain the user's names.
    """

    key: str
    files: tuple[tuple[str, str], ...]
    NAMES: None = None

    def plan(self, job: Job, report: Report) -> Iterator[Output]:
        """Yield the files of the ROS package, in `<key>/<package name>/`.

        If shmgen.toml has no topic, service or action, report SHM504. The package contains a copy of shmgen.toml with
        the bridge's settings. If the user has definitions, the package also contains copies of the definitions, and
        `path` in the copied shmgen.toml names the folder of these copies.
        """
        package = described(self.key, job, report)
        if package is None:
            return
        root = f"{self.key}/{package.name}"
        for file, template in self.files:
            yield Output(f"{root}/{file.format(package.name)}", f"ros/{template}", package)
        definitions = dict(_definitions(job.layouts))
        options = {key: value for key, value in job.options.configuration.items() if key not in _ELSEWHERE}
        configuration = toml.dumps({"path": ["msgs"], **options} if definitions else options)
        yield Output(f"{root}/config/shmgen.toml", "ros/shmgen.toml.j2", Text(configuration.rstrip("\n")))
        for path, text in definitions.items():
            yield Output(f"{root}/config/msgs/{path}", "text.j2", Text(text.rstrip("\n")))


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
"""The target for a catkin package."""
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
"""The target for an ament_python package."""


def beside(root: str, *targets: Iterator[Output]) -> Iterator[Output]:
    """Yield the planned files of other targets, moved to the folder `<root>/include`."""
    for output in chain(*targets):
        yield output._replace(path=f"{root}/include/{output.path.partition('/')[2]}")


def default_name(package: str) -> str:
    """Return the default name of the generated ROS package, which follows REP 144: `shm_msgs` -> `shm_msgs_bridge`."""
    words = re.findall("[a-z0-9]+", package.lower())
    return "_".join([*words, "bridge"])


_ELSEWHERE = ("path", "messages", "targets")
"""The keys to omit from the copy of shmgen.toml: folders of the project, and settings for `generate` only."""


def _definitions(layouts: Layouts) -> Iterator[tuple[str, str]]:
    """Yield the path and the text of each definition file to copy. Built-in definitions are not copied."""
    by_definition: dict[tuple[str, str, str], dict[str, Message]] = {}
    for name, layout in layouts.items():
        for part in _PARTS[name.kind]:
            if name.name.endswith(part) and not layout.message.origin.startswith("built-in"):
                bare = name.name.removesuffix(part)
                by_definition.setdefault((name.package, name.kind, bare), {})[part] = layout.message
    for (package, kind, bare), parts in sorted(by_definition.items()):
        if parts.keys() != set(_PARTS[kind]):
            continue
        first, *others = (parts[part] for part in _PARTS[kind])
        if first.span.path.endswith(".idl"):  # each part has the text of the whole file
            yield f"{package}/{kind}/{bare}.idl", first.text
        else:
            yield f"{package}/{kind}/{bare}.{kind}", "\n---\n".join(part.text.rstrip("\n") for part in (first, *others))
