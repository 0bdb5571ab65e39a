"""Turns layouts into C++ headers that convert between our classes and ROS's own, field by field, for either ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Clock, Layout, Output, Role, TypeName
from shmgen.targets import Job
from shmgen.targets.c.text import in_comment
from shmgen.targets.cpp.names import class_name, cpp_name, header, namespace, qualified
from shmgen.targets.naming import ClaimedName, Names, file_stem


def split(name: TypeName) -> tuple[TypeName, str] | None:
    """What ROS's file of it is called after, and which half of that it is: of a message none.

    None for what is ours alone, as a service's `_Reply` is.
    """
    if name.kind == "msg":
        return name, ""
    whole, _, half = name.name.rpartition("_")
    return (name._replace(name=whole), half) if half in _HALVES else None


_HALVES = ("Request", "Response", "Goal", "Result", "Feedback")


def _root(key: str, package: str) -> str:
    return f"{package}_{key.removeprefix('cpp_')}"


class Step(NamedTuple):
    """`member` on either side; `kind` is a tag that tells a time from a duration, where it is one."""

    member: str
    kind: str


class Header(NamedTuple):
    """One message; all strings finished."""

    title: str
    origin: str
    guard: str
    includes: tuple[str, ...]
    theirs: str
    ours: str
    type: str
    steps: tuple[Step, ...]
    adapts: bool


class Ros(NamedTuple):
    """A target. `include` and `type_name` are of what split() gives, as that ROS calls them."""

    key: str
    include: Callable[[TypeName, str], str]
    type_name: Callable[[TypeName, str], str]
    adapts: bool

    @property
    def NAMES(self) -> Names:
        """The classes are those of cpp and of ROS, the files its own."""
        return Names(f"C++ for ROS {self.key[-1]}", member=cpp_name, constant=cpp_name, made=self._made)

    def _made(self, layout: Layout, package: str) -> Iterator[ClaimedName]:
        if split(layout.name):
            yield ClaimedName("namespace", cpp_name(layout.name.package), package, layout.name.package)
            yield ClaimedName("class", class_name(layout.name), namespace(layout.name, package))
            yield ClaimedName("file", header(layout.name, _root(self.key, package)))

    def plan(self, job: Job, report: Report) -> Iterator[Output]:
        """`cpp_ros2/<package>_ros2/<ros package>/msg/pose.hpp` for all that ROS has, and what all share.

        They stand beside `cpp/`, whose classes they convert.
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
    lambda whole, half: f"::{cpp_name(whole.package)}::{cpp_name(whole.name + half)}",
    adapts=False,
)
"""roscpp's classes: `geometry_msgs::Pose`."""
ROS2 = Ros(
    "cpp_ros2",
    lambda whole, half: f"{whole.package}/{whole.kind}/{file_stem(whole)}.hpp",
    lambda whole, half: f"::{cpp_name(whole.package)}::{whole.kind}::{cpp_name(whole.name + (half and '_' + half))}",
    adapts=True,
)
"""rosidl's classes, `geometry_msgs::msg::Pose`, with TypeAdapters."""


def _header(ros: Ros, layout: Layout, package: str, root: str) -> Header:
    name, (whole, half) = layout.name, split(layout.name) or (layout.name, "")
    inner = (header(one, root) for one in sorted(layout.dependencies))
    return Header(
        title=str(name),
        origin=in_comment(layout.message.origin),
        guard=header(name, root).upper().replace("/", "_").replace(".", "_"),
        includes=(header(name, package), f"{root}/shmgen_ros.hpp", *inner),
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
            yield Step(cpp_name(slot.name), kind)
