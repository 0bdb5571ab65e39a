"""A table of the bridge's backends: the Python package that each needs, and how to install that package."""

from __future__ import annotations

from typing import NamedTuple


class Backend(NamedTuple):
    """A backend of the bridge, implemented in the package `shmgen.bridge.<key>`.

    `imports` is the Python package that the backend needs, and `install` the command that installs it. `ros_version` is
    the value of ROS_VERSION after the setup of the backend's ROS was sourced, or `""` if the backend needs no ROS.
    """

    key: str
    imports: str
    install: str
    ros_version: str = ""


BACKENDS = (
    Backend("ros2", "rclpy", "`source /opt/ros/jazzy/setup.bash`, in the Python that ROS was built for", "2"),
    Backend("dds", "cyclonedds", "`pip install cyclonedds`"),
    Backend("zenoh", "zenoh", "`pip install eclipse-zenoh xxhash`"),
    Backend("ros1", "rospy", "`apt-get install python3-rospy`, or `source /opt/ros/noetic/setup.bash`", "1"),
)
"""All backends, in the order in which the value `auto` tries them."""
