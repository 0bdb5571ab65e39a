"""Turns a Job into an ament_python package of ROS 2, `ros2/<name>/`, that starts the bridge."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.targets import Job
from shmgen.targets.ros import package

NAMES = None
"""The user's names stand in copies of the definitions alone."""

_FILES = (
    ("package.xml", "ros2_package.xml.j2"),
    ("setup.py", "ros2_setup.py.j2"),
    ("setup.cfg", "setup.cfg.j2"),
    ("resource/{}", "empty.j2"),
    ("{}/__init__.py", "bridge.py.j2"),
    ("launch/bridge.launch.py", "bridge.launch.py.j2"),
    ("config/bridge.yaml", "bridge.yaml.j2"),
)


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Reports SHM504 where there is nothing to carry."""
    return package.plan("ros2", _FILES, job, report)
