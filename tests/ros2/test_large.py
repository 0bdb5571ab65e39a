"""Large messages out of the bridge, by each backend: each is delivered, or in exactly one counter."""

from __future__ import annotations

import re
import signal
import subprocess
import time
from collections.abc import Callable
from typing import Any

import pytest

from shmgen.live.classes import publisher

from ..support.ros2 import Graph
from .test_bridge import session, topic

COUNT = 60
DDS = ("jazzy", "dds")
"""The bridge has the backend dds, and its peers are ROS nodes."""
READER = """
import sys, threading, rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node("reader")
seen = []
def take(data):
    seen.append(int.from_bytes(data[20:24], "little"))
node.create_subscription(Image, sys.argv[1], take, QoSProfile(depth=100), raw=True)
def listen():
    for line in sys.stdin:
        sys.stdout.write(" ".join(map(str, seen)) + "\\n")
threading.Thread(target=listen, daemon=True).start()
rclpy.spin(node)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("graph", "size", "rate", "stopped"),
    [("jazzy", 4, 30, 0.0), ("jazzy", 4, 30, 2.0), ("jazzy", 4, 30, 10.0), (DDS, 1, 20, 0.0)],
    indirect=["graph"],
)
def test_each_is_delivered_or_counted(graph: Graph, space: str, size: int, rate: int, stopped: float) -> None:
    """A reader that keeps up, one that stands still for less than the bridge waits for, and one for longer."""
    bridge, kind = started(graph, space, size)
    reader = Reader(graph, f"{space}/image")
    with publisher(kind, f"{space}/image", 16) as writer:
        image = kind()
        image.data = bytes(size * 2**20)
        before = found(reader, lambda: writer.publish(image))
        if stopped:
            reader.process.send_signal(signal.SIGSTOP)
        ends = time.monotonic() + stopped
        for number in range(1, COUNT + 1):
            image.height = number
            writer.publish(image)
            time.sleep(max(1 / rate, stopped / COUNT))
        time.sleep(max(0.0, ends - time.monotonic()))
        reader.process.send_signal(signal.SIGCONT)
        settled(reader)
        missing = COUNT - len(set(reader.seen()) - {0})
    passed, missed, lost = counted(bridge)
    assert passed + missed + lost == before + COUNT, bridge.lines[-1]
    # at most: ROS reports that all came, not which did not
    assert missed <= missing <= missed + lost, (bridge.lines[-1], missing)
    if stopped == 10:
        assert lost


@pytest.mark.slow
@pytest.mark.parametrize("graph", ["jazzy", DDS], indirect=True)
def test_a_reader_that_is_killed_holds_up_none_that_comes(graph: Graph, space: str) -> None:
    bridge, kind = started(graph, space, 1)
    reader = Reader(graph, f"{space}/image")
    with publisher(kind, f"{space}/image", 16) as writer:
        image = kind()
        image.data = bytes(2**20)
        sent = found(reader, lambda: writer.publish(image))
        reader.process.kill()
        for _ in range(20):
            writer.publish(image)
            time.sleep(1 / 20)
        sent += 20 + found(Reader(graph, f"{space}/image"), lambda: writer.publish(image))
        time.sleep(6)  # longer than the bridge waits for the reader that is gone
    assert sum(counted(bridge)) == sent, bridge.lines[-1]


def started(graph: Graph, space: str, size: int) -> tuple[Any, Any]:
    config = f'source = "jazzy"\nmax_region = 600000000\n[bounds]\n"sensor_msgs/Image.data" = {size * 2**20}\n'
    bridge = graph.bridge(config + topic(f"{space}/image", "sensor_msgs/Image", 'direction = "from_plc"', "depth = 16"))
    return bridge, session(graph).classes(["sensor_msgs/Image"])["sensor_msgs/msg/Image"]


class Reader:
    """A node of rclpy; `seen()` has the heights of the images that it got."""

    def __init__(self, graph: Graph, topic: str) -> None:
        self.process = graph.start([graph.python, "-c", READER, topic], stdin=subprocess.PIPE)

    def seen(self) -> list[int]:
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return [int(word) for word in self.process.stdout.readline().split()]


def settled(reader: Reader) -> None:
    """Wait until no image has come for six seconds, which is longer than the bridge waits for an acknowledgement."""
    before = -1
    while (now := len(reader.seen())) != before:
        before = now
        time.sleep(6)


def found(reader: Reader, publish: Callable[[], None]) -> int:
    """Publish until the reader gets it; return how often."""
    sent = 0
    while not reader.seen():
        publish()
        sent += 1
        time.sleep(0.5)
    return sent


def counted(bridge: Any) -> tuple[int, ...]:
    """End the bridge; return how many passed, were missed and were lost."""
    bridge.stop(signal.SIGINT)
    line = bridge.lines[-1]
    return tuple(int((re.search(rf"(\d+) {word}", line) or [0, 0])[1]) for word in ("passed", "missed", "lost"))
