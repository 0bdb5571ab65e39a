"""Turns layouts into headers between our C++ classes and rosidl's: `geometry_msgs::msg::Pose`, with TypeAdapters."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output, TypeName
from shmgen.targets import Job
from shmgen.targets.cpp.names import cpp_name
from shmgen.targets.cpp_ros import convert
from shmgen.targets.naming import file_stem

NAMES = convert.names("cpp_ros2")


def plan(job: Job, report: Report) -> Iterator[Output]:
    """`cpp_ros2/`, beside `cpp/`, whose classes it converts."""
    return convert.plan(convert.Ros("cpp_ros2", _include, _type, adapts=True), job, report)


def _include(whole: TypeName, half: str) -> str:
    return f"{whole.package}/{whole.kind}/{file_stem(whole)}.hpp"


def _type(whole: TypeName, half: str) -> str:
    return f"::{cpp_name(whole.package)}::{whole.kind}::{cpp_name(whole.name + (half and '_' + half))}"
