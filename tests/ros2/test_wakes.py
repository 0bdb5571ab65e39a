"""Test that a ROS 2 message wakes the thread of its topic, and not rclpy's executor, which is slow."""

from __future__ import annotations

import pytest

from ..conftest import REPOSITORY
from ..support.ros2 import Graph

MESSAGES = 300
SCRIPT = f"""
import threading
from rclpy import executors
from shmgen.bridge.ros2 import backend
from shmgen.bridge.backend import Node, Wire
from shmgen.bridge.common.counters import Counters
from shmgen.bridge.plan import closure
from shmgen.config import Config
from shmgen.generator import pipeline
from pathlib import Path

wakes = 0
rclpy = executors._rclpy

class Counted:
    # rclpy creates a new wait set for each wait.

    def __getattr__(self, name):
        global wakes
        wakes += name == "WaitSet"
        return getattr(rclpy, name)

executors._rclpy = Counted()
schema = pipeline.read(Config(Path.cwd()), ["geometry_msgs/Pose"])
wire = Wire("/wakes", closure(schema, schema.messages[-1].name))
graph = backend.connect(Node("wakes", None, print, lambda: False))
came = threading.Semaphore(0)
graph.subscribe(wire, lambda message: came.release(), Counters("/wakes", print))
outlet = graph.publisher(wire)
message = outlet.new()
for _ in range(200):
    outlet.send(message)
    if came.acquire(timeout=0.1):
        break
while came.acquire(timeout=0.5):
    pass
before = wakes
for _ in range({MESSAGES}):
    outlet.send(message)
    assert came.acquire(timeout=20)
print("wakes", wakes - before, flush=True)
graph.close()
"""


@pytest.mark.parametrize("graph", [("jazzy", "ros2"), ("kilted", "ros2")], indirect=True, ids="-".join)
def test_message_does_not_wake_the_executor(graph: Graph) -> None:
    process = graph.start([graph.python, "-c", SCRIPT], {"PYTHONPATH": str(REPOSITORY / "src")})
    output, _ = process.communicate(timeout=60)
    assert "wakes" in output, (graph.folder / "errors").read_text()
    assert int(output.split()[-1]) < MESSAGES / 10
