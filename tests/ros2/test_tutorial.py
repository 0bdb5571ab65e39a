"""docs/tutorial-plc.md and then docs/ros.md: a ROS 2 topic in the PLC, and one of the PLC in ROS 2."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time

import pytest

from ..conftest import REPOSITORY
from ..softplc import compile_st
from ..support.ros1 import LIMIT
from ..support.ros2 import Graph
from ..support.tutorial import project


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++: apt-get install g++")
@pytest.mark.parametrize("graph", [("jazzy", "ros2")], indirect=True, ids="-".join)
def test_a_ros_2_topic_in_the_plc_of_the_tutorial(graph: Graph, space: str) -> None:
    """A target from rclpy through the bridge to the tutorial's own program, and the belt's speed back."""
    settings, _, st = project(graph.folder, space)
    compile_st(st, graph.folder / "plc")
    graph.bridge(settings.replace('topic = "', f'topic = "{space}'))
    peer = graph.peer()
    peer.ask(do="advertise", topic=f"{space}/robot/target", type="geometry_msgs/msg/Pose")
    peer.ask(do="subscribe", topic=f"{space}/conveyor/speed", type="std_msgs/msg/Float64")
    command = [sys.executable, "-m", "tests.softplc.task", graph.folder / "plc" / "plc.so", "PRG_Ros", "PRG_Conveyor"]
    with subprocess.Popen(command, cwd=REPOSITORY) as plc:
        try:
            deadline, speeds = time.monotonic() + LIMIT, []
            while {"data": 0.75} not in speeds:
                assert time.monotonic() < deadline, f"the PLC said {speeds[-3:]}"
                peer.ask(do="publish", topic=f"{space}/robot/target", messages=[{"position": {"x": 1.5}}])
                speeds += peer.ask(do="take", topic=f"{space}/conveyor/speed", count=1, timeout=0.2)
        finally:
            plc.kill()
