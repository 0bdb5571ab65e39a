"""`shmgen bridge` between real rclpy nodes and regions, one process each, by way of rclpy and of Cyclone."""

from __future__ import annotations

import time

import pytest

from ..support.ros2 import Graph

WAYS = [(distribution, backend) for distribution in ("jazzy", "kilted") for backend in ("ros2", "dds")]
both = pytest.mark.parametrize("graph", WAYS, indirect=True, ids="-".join)


def config(graph: Graph, topic: str, type_: str, *keys: str, back: str = "") -> str:
    """A topic to the PLC, and the same sent back by another bridge."""
    text = f'source = "{graph.source}"\n[bridge]\ndiagnostics = 0.2\n[[topics]]\ntopic = "{topic}"\ntype = "{type_}"\n'
    return text + "".join(f"{key}\n" for key in keys) + back


@both
def test_a_topic_to_the_plc(graph: Graph, space: str) -> None:

    bridge = graph.bridge(config(graph, f"{space}/pose", "geometry_msgs/PoseStamped"))
    peer = graph.peer()
    peer.ask(do="advertise", topic=f"{space}/pose", type="geometry_msgs/msg/PoseStamped")
    assert peer.ask(do="connected", topic=f"{space}/pose") == 1
    peer.ask(do="publish", topic=f"{space}/pose", messages=[{"pose": {"position": {"x": 1.5}}}] * 3)
    time.sleep(0.5)
    bridge.stop(15)
    bridge.said(f"{space}/pose +3 passed$")
    print(bridge.lines)
