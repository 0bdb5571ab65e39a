"""Turns a Job into a catkin package of ROS 1, `ros1/<name>/`, that starts the bridge."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.targets import Job
from shmgen.targets.ros import package

NAMES = None
"""The user's names stand in copies of the definitions alone."""

_FILES = (
    ("package.xml", "ros1_package.xml.j2"),
    ("CMakeLists.txt", "CMakeLists.txt.j2"),
    ("setup.py", "ros1_setup.py.j2"),
    ("src/{}/__init__.py", "bridge.py.j2"),
    ("scripts/bridge", "script.j2"),
    ("launch/bridge.launch", "bridge.launch.j2"),
)


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Reports SHM504 where there is nothing to carry."""
    return package.plan("ros1", _FILES, job, report)
