"""The node of docs/python.md: topics of ROS and regions in one executor of rclpy."""

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
def test_one_executor_for_ros_and_regions(graph: Graph, tmp_path: Path, topic: str) -> None:
    page = (REPOSITORY / "docs" / "python.md").read_text()
    found = re.search(r"\n( {4}class Listener\(Node\):\n(?:(?: {4}.*)?\n)+)", page)
    assert found
    text = BEFORE + textwrap.dedent(found[1]) + AFTER
    (tmp_path / "node.py").write_text(text.replace("/robot/speech", topic))
    assert run(["generate", "std_msgs/String", "-t", "python", "-q"], tmp_path).code == 0
    node = graph.start([graph.python, "node.py"], {"PYTHONPATH": str(REPOSITORY / "src")})
    seen: set[str] = set()
    end = time.monotonic() + 60
    while seen != {"ROS: hello", "region: hello"} and time.monotonic() < end:
        seen.add(node.stdout.readline().strip())
    assert seen == {"ROS: hello", "region: hello"}, (tmp_path / "errors").read_text()
