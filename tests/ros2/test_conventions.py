"""Test that node name, namespace, remapping and simulated time have equal effects with each backend."""

from __future__ import annotations

from typing import Any

import pytest

from shmgen.live.classes import publisher

from ..support.ros1 import wait_for
from ..support.ros2 import Graph
from .test_bridge import session, topic

STAMPED = "geometry_msgs/PoseStamped"
REMAPPINGS = ("__ns:=/cell1", "__node:=cell_4", "{space}/pose:=/other{space}/pose", "/clock:={space}/clock")


@pytest.mark.parametrize("graph", ["jazzy", ("jazzy", "dds")], indirect=True)
def test_arguments_have_equal_effects_with_each_backend(graph: Graph, space: str) -> None:
    bare = space.removeprefix("/")
    config = f'source = "{graph.source}"\n[bridge]\ndiagnostics = 0.2\n' + topic(f"{space}/pose", STAMPED)
    config += topic(f"{bare}/out", STAMPED, 'direction = "from_plc"')
    rules = [word for rule in REMAPPINGS for word in ("-r", rule.format(space=space))]
    arguments = ["--ros-args", *rules, "-p", "use_sim_time:=true"]
    bridge, peer = graph.bridge(config, *arguments), graph.peer()
    peer.ask(do="advertise", topic=f"/other{space}/pose", type="geometry_msgs/msg/PoseStamped")
    assert peer.ask(do="connected", topic=f"/other{space}/pose") == 1
    peer.ask(do="subscribe", topic="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")
    peer.ask(do="subscribe", topic=f"/cell1{space}/out", type="geometry_msgs/msg/PoseStamped")
    peer.ask(do="advertise", topic=f"{space}/clock", type="rosgraph_msgs/msg/Clock")
    kind = session(graph).classes([STAMPED])["geometry_msgs/msg/PoseStamped"]
    stamps: list[int] = []

    def has_simulated_stamp() -> bool:
        peer.ask(do="publish", topic=f"{space}/clock", messages=[{"clock": {"sec": 1234}}])
        writer.publish(kind())
        messages: list[Any] = peer.ask(do="take", topic=f"/cell1{space}/out", count=1, timeout=0.2)
        stamps.extend(message["header"]["stamp"]["sec"] for message in messages)
        return 1234 in stamps

    with publisher(kind, f"{bare}/out", 1) as writer:  # the region has the name in shmgen.toml
        wait_for(has_simulated_stamp, "a stamp of the simulation", lambda: f"{stamps} {''.join(bridge.lines)}")
    names = {status["name"] for status in peer.ask(do="take", topic="/diagnostics", count=1)[0]["status"]}
    assert names == {f"cell_4: {space}/pose", f"cell_4: {bare}/out"}


@pytest.mark.parametrize("graph", ["jazzy", ("jazzy", "dds")], indirect=True)
def test_rate_parameter_limits_a_topic(graph: Graph, space: str) -> None:
    config = f'source = "{graph.source}"\n' + topic(f"{space}/pose", STAMPED)
    bridge, peer = graph.bridge(config, "--ros-args", "-p", "rate:=0.01", "-p", "other:rate:=100"), graph.peer()
    peer.ask(do="advertise", topic=f"{space}/pose", type="geometry_msgs/msg/PoseStamped")
    assert peer.ask(do="connected", topic=f"{space}/pose") == 1
    peer.ask(do="publish", topic=f"{space}/pose", messages=[{}] * 20)
    bridge.counted(f"{space}/pose +1 passed, \\d+ rate limited")  # the limiter holds the newest message
