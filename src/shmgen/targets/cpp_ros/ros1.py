"""Turns layouts into headers between our C++ classes and roscpp's: `geometry_msgs::Pose`."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output, TypeName
from shmgen.targets import Job
from shmgen.targets.cpp.names import cpp_name
from shmgen.targets.cpp_ros import convert

NAMES = convert.names("cpp_ros1")


def plan(job: Job, report: Report) -> Iterator[Output]:
    """`cpp_ros1/`, beside `cpp/`, whose classes it converts."""
    return convert.plan(convert.Ros("cpp_ros1", _include, _type, adapts=False), job, report)


def _include(whole: TypeName, half: str) -> str:
    return f"{whole.package}/{whole.name}{half}.h"


def _type(whole: TypeName, half: str) -> str:
    return f"::{cpp_name(whole.package)}::{cpp_name(whole.name + half)}"
