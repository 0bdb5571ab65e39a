"""Turns what is installed, and what the environment says, into the backend to use."""

from __future__ import annotations

import importlib
import importlib.util
import os
from types import ModuleType

from shmgen.bridge.backend import BackendMissing

INSTALL = {
    "ros1": "rospy is missing: `apt-get install python3-rospy`, or `source /opt/ros/noetic/setup.bash`",
    "ros2": "rclpy is missing: `source /opt/ros/jazzy/setup.bash`, in the Python that ROS was built for",
    "dds": "cyclonedds is missing: `pip install cyclonedds`",
}
_MADE_OF = {"ros1": "rospy", "ros2": "rclpy", "dds": "cyclonedds"}
_BY_VERSION = {"1": "ros1", "2": "ros2"}


def chosen(name: str) -> tuple[str, str]:
    """The backend's name, and why it is this one. Raises BackendMissing."""
    if name != "auto":
        return name, "as told"
    if by_version := _BY_VERSION.get(os.environ.get("ROS_VERSION", "")):
        return by_version, f"ROS_VERSION is {os.environ['ROS_VERSION']}"
    for backend in ("ros2", "ros1", "dds"):
        if importlib.util.find_spec(_MADE_OF[backend]):
            return backend, f"{_MADE_OF[backend]} is installed"
    lines = "\n".join(f"  {backend}: {hint}" for backend, hint in INSTALL.items())
    raise BackendMissing(f"there is no ROS here, and no DDS; one of these is needed\n{lines}")


def module(backend: str) -> ModuleType:
    """Of `shmgen.bridge`. Raises BackendMissing."""
    if not importlib.util.find_spec(_MADE_OF[backend]):
        raise BackendMissing(f"backend {backend}: {INSTALL[backend]}")
    return importlib.import_module(f"shmgen.bridge.{backend}")
