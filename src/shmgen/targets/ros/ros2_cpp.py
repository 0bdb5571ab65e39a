"""Generate an ament_cmake package for ROS 2, `ros2_cpp/<name>/`: the bridge as a node in C++."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.targets import Job
from shmgen.targets.cpp import target as cpp
from shmgen.targets.cpp.names import header, qualified
from shmgen.targets.cpp_ros.convert import ROS2
from shmgen.targets.ros import package

NAMES = cpp.NAMES

_FILES = (
    ("package.xml", "cpp_package.xml.j2"),
    ("CMakeLists.txt", "cpp_CMakeLists.txt.j2"),
    ("launch/bridge.launch.py", "cpp_bridge.launch.py.j2"),
    ("src/bridge.cpp", "bridge.cpp.j2"),
)
_RUNTIME = ("shmgen_node.hpp", "shmgen_peers.hpp", "shmgen_service_sides.hpp", "shmgen_side.hpp",
            "shmgen_topic_sides.hpp")  # fmt: skip
"""Handwritten headers in templates/cpp_ros."""
_OF_THE_USE = ("topic", "service", "type", "direction", "server")


class Use(NamedTuple):
    """A topic, service or action that the node transfers, as a C++ function call.

    `way` is the function in shmgen_node.hpp, and `types` are its template arguments. `options` is C++ code that sets
    options of the class Carried.
    """

    way: str
    types: str
    name: str
    options: str


class Node(NamedTuple):
    """The template data for the node's package. `diagnostics` is the interval of its diagnostic messages in seconds."""

    package: package.Package
    diagnostics: str
    includes: tuple[str, ...]
    uses: tuple[Use, ...]


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield the files of the package. If shmgen.toml has no topic, service or action, report SHM504."""
    about = package.described("ros2_cpp", job, report)
    if about is None:
        return
    about = about._replace(dependencies=tuple(sorted({*about.dependencies, "diagnostic_msgs"})))
    root = f"ros2_cpp/{about.name}"
    period = json.dumps(job.options.configuration.get("bridge", {}).get("diagnostics", 1.0))
    view = Node(about, period, tuple(_includes(job)), tuple(_uses(job)))
    for file, template in _FILES:
        yield Output(f"{root}/{file}", f"ros/{template}", view)
    yield Output(f"{root}/config/bridge.yaml", "ros/bridge.yaml.j2", about)
    yield from package.beside(root, cpp.plan(job, report), ROS2.plan(job, report))
    for name in _RUNTIME:
        yield Output(f"{root}/include/{job.package}_ros2/{name}", f"cpp_ros/{name}", None)


def _uses(job: Job) -> Iterator[Use]:
    document = job.options.configuration  # the values are already checked
    for topic, table in zip(job.topics, document.get("topics", ()), strict=True):
        way = "to_plc" if topic.to_plc else "from_plc"
        yield Use(way, f"<{qualified(topic.type, job.package)}>", topic.name, _options(table))
    for service, table in zip(job.services, document.get("services", ()), strict=True):
        types = f"<{qualified(service.type, job.package)}, {ROS2.type_name(service.type, '')}>"
        yield Use("plc_serves" if service.on_plc else "plc_calls", types, service.name, _options(table))
    for action in job.actions:
        yield Use("leave_out", "", action.name, "")


def _options(table: Mapping[str, object]) -> str:
    return "".join(f".{key}({json.dumps(value)})" for key, value in table.items() if key not in _OF_THE_USE)


def _includes(job: Job) -> Iterator[str]:
    yield f"{job.package}/shmgen_calls.hpp"
    root = f"{job.package}_ros2"
    yield from dict.fromkeys(header(topic.type, root) for topic in job.topics)
    for type_ in dict.fromkeys(service.type for service in job.services):
        yield f"{header(type_, job.package).removesuffix('.hpp')}_service.hpp"
        yield from (header(type_.part(part), root) for part in ("_Request", "_Response"))
    yield f"{root}/shmgen_node.hpp"
