"""Test the node of docs/python.md, which handles ROS topics and regions in one rclpy executor."""

from __future__ import annotations

import re
import textwrap
import time
from pathlib import Path

import pytest

from ..conftest import REPOSITORY
from ..support.command import run
from ..support.ros2 import Graph

BEFORE = """
import select, sys, threading
import rclpy
from rclpy.node import Node
from shmgen.runtime import Notifier
from std_msgs.msg import String as RosString
sys.path.insert(0, "generated/python")
from shm_msgs.std_msgs.msg import String, StringPublisher, StringSubscriber

"""
AFTER = """
class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        self.chatter = self.create_publisher(RosString, "/chatter", 10)
        self.speech = StringPublisher("/robot/speech", depth=4)
        self.create_timer(0.05, self.talk)

    def talk(self):
        self.chatter.publish(RosString(data="hello"))
        self.speech.publish(String(data="hello"))

rclpy.init()
executor = rclpy.executors.SingleThreadedExecutor()
for node in (Listener(), Talker()):
    executor.add_node(node)
executor.spin()
"""


@pytest.mark.parametrize("graph", ["jazzy"], indirect=True)
def test_executor_handles_ros_topics_and_regions(graph: Graph, tmp_path: Path, topic: str) -> None:
    page = (REPOSITORY / "docs" / "python.md").read_text()
    match = re.search(r"\n( {4}class Listener\(Node\):\n(?:(?: {4}.*)?\n)+)", page)
    assert match
    text = BEFORE + textwrap.dedent(match[1]) + AFTER
    (tmp_path / "node.py").write_text(text.replace("/robot/speech", topic))
    assert run(["generate", "std_msgs/String", "-t", "python", "-q"], tmp_path).code == 0
    node = graph.start([graph.python, "node.py"], {"PYTHONPATH": str(REPOSITORY / "src")})
    lines: set[str] = set()
    deadline = time.monotonic() + 60
    while lines != {"ROS: hello", "region: hello"} and time.monotonic() < deadline:
        lines.add(node.stdout.readline().strip())
    assert lines == {"ROS: hello", "region: hello"}, (tmp_path / "errors").read_text()
