"""The backends of the bridge: one entry is all that shmgen knows of one."""

from __future__ import annotations

from typing import NamedTuple


class Backend(NamedTuple):
    """A backend of the bridge, the package `shmgen.bridge.<key>`.

    `imports` is what it is made of, `install` what to type where that is missing, and `ros_version` what ROS_VERSION
    is where the setup of its ROS was sourced.
    """

    key: str
    imports: str
    install: str
    ros_version: str = ""


BACKENDS = (
    Backend("ros2", "rclpy", "`source /opt/ros/jazzy/setup.bash`, in the Python that ROS was built for", "2"),
    Backend("dds", "cyclonedds", "`pip install cyclonedds`"),
    Backend("zenoh", "zenoh", "`pip install eclipse-zenoh`"),
    Backend("ros1", "rospy", "`apt-get install python3-rospy`, or `source /opt/ros/noetic/setup.bash`", "1"),
)
"""In the order in which `auto` looks for them."""
