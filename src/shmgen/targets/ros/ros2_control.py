"""Generate an ament_cmake package for ROS 2, `ros2_control/<name>/`: a PLC as a SystemInterface."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Layout, Layouts, Output, Ref, Role, Scalar, Topic
from shmgen.targets import Job
from shmgen.targets.counts import counts
from shmgen.targets.cpp import target as cpp
from shmgen.targets.cpp.names import header, qualified
from shmgen.targets.ros import package

NAMES = cpp.NAMES

_FILES = (
    ("package.xml", "package.xml.j2"),
    ("CMakeLists.txt", "CMakeLists.txt.j2"),
    ("plugin.xml", "plugin.xml.j2"),
    ("src/system.cpp", "system.cpp.j2"),
    ("urdf/plc.ros2_control.xacro", "urdf.xacro.j2"),
    ("config/controllers.yaml", "controllers.yaml.j2"),
    ("launch/control.launch.py", "control.launch.py.j2"),
)
_RUNTIME = ("shmgen_control.hpp", "shmgen_fields.hpp")
"""Handwritten headers in templates/ros2_control."""
_KINDS = {Scalar.BOOL: "boolean", **{kind: kind.value for kind in Scalar if kind.value[-2:] in ("t8", "16", "32")},
          Scalar.FLOAT64: "float64"}  # fmt: skip
"""The types that a double represents exactly. int64 and uint64 are therefore excluded."""


class Number(NamedTuple):
    """A number in a message. A `path` through an array, such as `joints[].x`, stands for the numbers of all elements.

    `dimensions` has an entry for each array on the path, outermost first. An entry contains the arguments of the C++
    class `Dimension`. `length` is the product of the lengths of these arrays.
    """

    path: str
    kind: str
    offset: str
    dimensions: tuple[str, ...]
    length: int = 1


class Region(NamedTuple):
    """The template data for a topic. `way` is the C++ class that transfers the topic: Commands or States.

    `list` is the C++ variable that contains all objects of this class.
    """

    way: str
    list: str
    type: str
    name: str
    depth: str
    numbers: tuple[Number, ...]


class Interface(NamedTuple):
    """An interface of a joint or gpio in the URDF, for the number `field` of `topic`. `way` is `command` or `state`."""

    way: str
    name: str
    topic: str
    field: str


class Component(NamedTuple):
    """A component in the URDF: a joint or a gpio."""

    tag: str
    name: str
    interfaces: tuple[Interface, ...]


class ForwardController(NamedTuple):
    """A controller that writes the command interface `command` of `joints`."""

    command: str
    joints: list[str]


class Gpio(NamedTuple):
    """A gpio that the gpio_controller writes, and the names of its command interfaces."""

    name: str
    commands: list[str]


class System(NamedTuple):
    package: package.Package
    includes: tuple[str, ...]
    regions: tuple[Region, ...]
    components: tuple[Component, ...]
    forward_controllers: tuple[ForwardController, ...]
    gpios: tuple[Gpio, ...]


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield the files of the package. If shmgen.toml has no topic, service or action, report SHM504."""
    about = package.described("ros2_control", job, report)
    if about is None:
        return
    regions = tuple(_region(topic, job) for topic in job.topics)
    components = tuple(_components(regions))
    includes = tuple(dict.fromkeys(header(topic.type, job.package) for topic in job.topics))
    view = System(about, includes, regions, components, *_controllers(components))
    root = f"ros2_control/{about.name}"
    for file, template in _FILES:
        yield Output(f"{root}/{file}", f"ros2_control/{template}", view)
    yield from package.beside(root, cpp.plan(job, report))
    for name in _RUNTIME:
        yield Output(f"{root}/include/{name}", f"ros2_control/{name}", None)


def _region(topic: Topic, job: Job) -> Region:
    way, list_ = ("Commands", "commands_for_plc_") if topic.to_plc else ("States", "states_of_plc_")
    numbers = tuple(_numbers(job.layouts[topic.type], job.layouts))
    return Region(way, list_, qualified(topic.type, job.package), topic.name, str(topic.depth), numbers)


def _numbers(
    layout: Layout, layouts: Layouts, prefix: str = "", offset: int = 0, around: tuple[str, ...] = (), length: int = 1
) -> Iterator[Number]:
    counters = counts(layout)
    for slot in layout.slots:
        if slot.role is not Role.DATA:
            continue
        path, at, dimensions = prefix + slot.name, offset + slot.offset, around
        if slot.count is not None:
            counter = offset + counters[slot.name].offset if slot.name in counters else -1
            path, dimensions = f"{path}[]", (*around, f"{slot.count}, {slot.element_size}, {counter}")
        total = length * (slot.count or 1)
        if isinstance(slot.type, Ref):
            yield from _numbers(layouts[slot.type.name], layouts, f"{path}.", at, dimensions, total)
        elif kind := _KINDS.get(slot.type) if isinstance(slot.type, Scalar) else None:
            yield Number(path, kind, str(at), dimensions, total)


def _components(regions: tuple[Region, ...]) -> Iterator[Component]:
    """Yield the joints and gpios of the URDF, with an interface for each number in `regions`.

    Arrays of joint values, such as `position[]`, become joints: `joint1` has the first element of each of these arrays.
    Other arrays of the same length become gpios: `axis1` has the first element of each. The gpio `plc` has all numbers
    outside arrays.
    """
    by_component: dict[tuple[str, str], list[Interface]] = {}
    plain = [(region, number) for region in regions for number in region.numbers if "." not in number.path]
    size = max((number.length for _, number in plain if number.path in _OF_JOINTS), default=0)
    for region, number in plain:
        way, name = "command" if region.way == "Commands" else "state", number.path.removesuffix("[]")
        if not number.dimensions:
            by_component.setdefault(("gpio", "plc"), []).append(Interface(way, name, region.name, name))
        elif number.length == size:
            tag = "joint" if number.path in _OF_JOINTS else "gpio"
            for index in range(size):
                key = tag, f"{'joint' if tag == 'joint' else 'axis'}{index + 1}"
                by_component.setdefault(key, []).append(Interface(way, name, region.name, f"{name}[{index}]"))
    for (tag, name), interfaces in sorted(by_component.items(), key=lambda item: item[0][0] == "gpio"):
        yield Component(tag, name, tuple(sorted(interfaces)))


def _controllers(components: tuple[Component, ...]) -> tuple[tuple[ForwardController, ...], tuple[Gpio, ...]]:
    """Return controllers for all command interfaces: the plugin sends a topic only if each of them has a value."""
    joints: dict[str, list[str]] = {}
    gpios: dict[str, list[str]] = {}
    for component in components:
        for command in (it.name for it in component.interfaces if it.way == "command"):
            if component.tag == "joint":
                joints.setdefault(command, []).append(component.name)
            else:
                gpios.setdefault(component.name, []).append(command)
    return tuple(ForwardController(*it) for it in joints.items()), tuple(Gpio(*it) for it in gpios.items())


_OF_JOINTS = ("position[]", "velocity[]", "acceleration[]", "effort[]")
