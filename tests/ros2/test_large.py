"""Test that the bridge delivers each large message or counts it in exactly one counter, with each backend."""

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


@pytest.mark.sample("[jazzy-4-30-2.0]")
@pytest.mark.parametrize(
    ("graph", "size", "rate", "stopped"),
    [("jazzy", 4, 30, 0.0), ("jazzy", 4, 30, 2.0), ("jazzy", 4, 30, 10.0), (DDS, 1, 20, 0.0)],
    indirect=["graph"],
)
def test_large_message_is_delivered_or_counted(graph: Graph, space: str, size: int, rate: int, stopped: float) -> None:
    """Use a reader that keeps up, and readers that stop for less time and for more time than the bridge waits."""
    bridge, kind = start_bridge(graph, space, size)
    reader = Reader(graph, f"{space}/image")
    with publisher(kind, f"{space}/image", 16) as writer:
        image = kind()
        image.data = bytes(size * 2**20)
        before = publish_until_received(reader, lambda: writer.publish(image))
        if stopped:
            reader.process.send_signal(signal.SIGSTOP)
        ends_at = time.monotonic() + stopped
        for number in range(1, COUNT + 1):
            image.height = number
            writer.publish(image)
            time.sleep(max(1 / rate, stopped / COUNT))
        time.sleep(max(0.0, ends_at - time.monotonic()))
        reader.process.send_signal(signal.SIGCONT)
        wait_until_quiet(reader)
        missing = COUNT - len(set(reader.heights()) - {0})
    passed, missed, lost = stop_and_count(bridge)
    assert passed + missed + lost == before + COUNT, bridge.lines[-1]
    # `lost` is an upper limit: ROS reports whether all messages arrived, not which are missing
    assert missed <= missing <= missed + lost, (bridge.lines[-1], missing)
    if stopped == 10:
        assert lost


@pytest.mark.sample("[jazzy]")
@pytest.mark.parametrize("graph", ["jazzy", DDS], indirect=True)
def test_killed_reader_does_not_delay_the_next_reader(graph: Graph, space: str) -> None:
    bridge, kind = start_bridge(graph, space, 1)
    reader = Reader(graph, f"{space}/image")
    with publisher(kind, f"{space}/image", 16) as writer:
        image = kind()
        image.data = bytes(2**20)
        sent = publish_until_received(reader, lambda: writer.publish(image))
        reader.process.kill()
        for _ in range(20):
            writer.publish(image)
            time.sleep(1 / 20)
        sent += 20 + publish_until_received(Reader(graph, f"{space}/image"), lambda: writer.publish(image))
        time.sleep(6)  # longer than the bridge waits for the killed reader
    assert sum(stop_and_count(bridge)) == sent, bridge.lines[-1]


def start_bridge(graph: Graph, space: str, size: int) -> tuple[Any, Any]:
    config = f'source = "jazzy"\nmax_region = 600000000\n[bounds]\n"sensor_msgs/Image.data" = {size * 2**20}\n'
    bridge = graph.bridge(config + topic(f"{space}/image", "sensor_msgs/Image", 'direction = "from_plc"', "depth = 16"))
    return bridge, session(graph).classes(["sensor_msgs/Image"])["sensor_msgs/msg/Image"]


class Reader:
    """An rclpy node. `heights()` returns the heights of the received images."""

    def __init__(self, graph: Graph, topic: str) -> None:
        self.process = graph.start([graph.python, "-c", READER, topic], stdin=subprocess.PIPE)

    def heights(self) -> list[int]:
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return [int(word) for word in self.process.stdout.readline().split()]


def wait_until_quiet(reader: Reader) -> None:
    """Wait until no image has arrived for 6 s, which is longer than the bridge waits for an acknowledgement."""
    before = -1
    while (now := len(reader.heights())) != before:
        before = now
        time.sleep(6)


def publish_until_received(reader: Reader, publish: Callable[[], None]) -> int:
    """Publish until the reader receives an image, and return the number of published images."""
    sent = 0
    while not reader.heights():
        publish()
        sent += 1
        time.sleep(0.5)
    return sent


def stop_and_count(bridge: Any) -> tuple[int, ...]:
    """Stop the bridge, and return how many messages passed, were missed and were lost."""
    bridge.stop(signal.SIGINT)
    line = bridge.lines[-1]
    return tuple(int((re.search(rf"(\d+) {word}", line) or [0, 0])[1]) for word in ("passed", "missed", "lost"))
