"""Generate C++ headers that convert between shmgen's and ROS's classes, field by field, for ROS 1 and ROS 2."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Clock, Layout, Output, Role, TypeName
from shmgen.targets import Job
from shmgen.targets.c.names import c_member
from shmgen.targets.c.text import Head, head
from shmgen.targets.cpp.names import class_name, header, namespace, qualified
from shmgen.targets.naming import ClaimedName, Names, file_stem


def split(name: TypeName) -> tuple[TypeName, str] | None:
    """Return the ROS type whose definition contains a message, and the message's part of this type, such as `Request`.

    The part is `""` for a plain message. Return None for messages that ROS does not have, such as shmgen's `_Reply`.
    """
    if name.kind == "msg":
        return name, ""
    whole, _, half = name.name.rpartition("_")
    return (name._replace(name=whole), half) if half in _HALVES else None


_HALVES = ("Request", "Response", "Goal", "Result", "Feedback")


def _root(key: str, package: str) -> str:
    return f"{package}_{key.removeprefix('cpp_')}"


class Step(NamedTuple):
    """A field that the header converts from shmgen's class to ROS's class and back. `member` is its name in C++.

    `kind` is a C++ type that selects the conversion: `::shmgen::time`, `::shmgen::duration`, or `void` for all others.
    """

    member: str
    kind: str


class Header(NamedTuple):
    """The template data for the header that converts one message, as finished C++ code."""

    head: Head
    theirs: str
    ours: str
    type: str
    steps: tuple[Step, ...]
    adapts: bool


class Ros(NamedTuple):
    """The target that generates the conversions for one version of ROS, 1 or 2.

    `include` returns the path of ROS's header for a message, and `type_name` the name of ROS's class. Both take the
    message's definition and part, as split() returns them. If `adapts`, the headers also define rclcpp TypeAdapters.
    """

    key: str
    include: Callable[[TypeName, str], str]
    type_name: Callable[[TypeName, str], str]
    adapts: bool

    @property
    def NAMES(self) -> Names:
        """The naming rules. Only the names of files are new: classes keep their names from the target cpp."""
        return Names(f"C++ for ROS {self.key[-1]}", member=c_member, constant=c_member, claims=self._claims)

    def _claims(self, layout: Layout, package: str) -> Iterator[ClaimedName]:
        if split(layout.name):
            yield ClaimedName("namespace", c_member(layout.name.package), package, layout.name.package)
            yield ClaimedName("class", class_name(layout.name), namespace(layout.name, package))
            yield ClaimedName("file", header(layout.name, _root(self.key, package)))

    def plan(self, job: Job, report: Report) -> Iterator[Output]:
        """Yield `cpp_ros2/<package>_ros2/<ros package>/msg/pose.hpp` for each type that ROS has, and the shared file.

        The headers convert the classes of the target cpp and include its files.
        """
        root = _root(self.key, job.package)
        yield Output(f"{self.key}/{root}/shmgen_ros.hpp", "cpp_ros/shmgen_ros.hpp", None)
        for name, layout in job.layouts.items():
            if split(name):
                view = _header(self, layout, job.package, root)
                yield Output(f"{self.key}/{header(name, root)}", "cpp_ros/convert.hpp.j2", view)


ROS1 = Ros(
    "cpp_ros1",
    lambda whole, half: f"{whole.package}/{whole.name}{half}.h",
    lambda whole, half: f"::{c_member(whole.package)}::{c_member(whole.name + half)}",
    adapts=False,
)
"""The target for roscpp's classes, such as `geometry_msgs::Pose`."""
ROS2 = Ros(
    "cpp_ros2",
    lambda whole, half: f"{whole.package}/{whole.kind}/{file_stem(whole)}.hpp",
    lambda whole, half: f"::{c_member(whole.package)}::{whole.kind}::{c_member(whole.name + (half and '_' + half))}",
    adapts=True,
)
"""The target for rosidl's classes, such as `geometry_msgs::msg::Pose`, with TypeAdapters."""


def _header(ros: Ros, layout: Layout, package: str, root: str) -> Header:
    name, (whole, half) = layout.name, split(layout.name) or (layout.name, "")
    includes = [header(name, package), f"{root}/shmgen_ros.hpp"]
    includes += (header(one, root) for one in sorted(layout.dependencies))
    summary = f"Conversion of {name} between shared memory and ROS ({ros.type_name(whole, half)})."
    return Header(
        head=head(summary, layout.message.origin, header(name, root), includes),
        theirs=ros.include(whole, half),
        ours=qualified(name, package),
        type=ros.type_name(whole, half),
        steps=tuple(_steps(layout)),
        adapts=ros.adapts,
    )


def _steps(layout: Layout) -> Iterator[Step]:
    for slot in layout.slots:
        if slot.role is Role.DATA:
            kind = f"::shmgen::{slot.type.value}" if isinstance(slot.type, Clock) else "void"
            yield Step(c_member(slot.name), kind)
