"""Node name, namespace, remapping and simulated time: the same graph with each backend."""

from __future__ import annotations

from typing import Any

import pytest

from shmgen.live.classes import publisher

from ..support.ros1 import wait_for
from ..support.ros2 import Graph
from .test_bridge import session, topic

STAMPED = "geometry_msgs/PoseStamped"
REMAPPED = ("__ns:=/cell1", "__node:=cell_4", "{space}/pose:=/other{space}/pose", "/clock:={space}/clock")


@pytest.mark.parametrize("graph", ["jazzy", ("jazzy", "dds")], indirect=True)
def test_one_command_line_makes_the_same_graph(graph: Graph, space: str) -> None:
    bare = space.removeprefix("/")
    config = f'source = "{graph.source}"\n[bridge]\ndiagnostics = 0.2\n' + topic(f"{space}/pose", STAMPED)
    config += topic(f"{bare}/out", STAMPED, 'direction = "from_plc"')
    rules = [word for rule in REMAPPED for word in ("-r", rule.format(space=space))]
    words = ["--ros-args", *rules, "-p", "use_sim_time:=true"]
    bridge, peer = graph.bridge(config, *words), graph.peer()
    peer.ask(do="advertise", topic=f"/other{space}/pose", type="geometry_msgs/msg/PoseStamped")
    assert peer.ask(do="connected", topic=f"/other{space}/pose") == 1
    peer.ask(do="subscribe", topic="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")
    peer.ask(do="subscribe", topic=f"/cell1{space}/out", type="geometry_msgs/msg/PoseStamped")
    peer.ask(do="advertise", topic=f"{space}/clock", type="rosgraph_msgs/msg/Clock")
    kind = session(graph).classes([STAMPED])["geometry_msgs/msg/PoseStamped"]
    stamps: list[int] = []

    def simulated() -> bool:
        peer.ask(do="publish", topic=f"{space}/clock", messages=[{"clock": {"sec": 1234}}])
        writer.publish(kind())
        came: list[Any] = peer.ask(do="take", topic=f"/cell1{space}/out", count=1, timeout=0.2)
        stamps.extend(one["header"]["stamp"]["sec"] for one in came)
        return 1234 in stamps

    with publisher(kind, f"{bare}/out", 1) as writer:  # the region has the name of shmgen.toml
        wait_for(simulated, "a stamp of the simulation", lambda: f"{stamps} {''.join(bridge.lines)}")
    names = {one["name"] for one in peer.ask(do="take", topic="/diagnostics", count=1)[0]["status"]}
    assert names == {f"cell_4: {space}/pose", f"cell_4: {bare}/out"}


@pytest.mark.parametrize("graph", ["jazzy", ("jazzy", "dds")], indirect=True)
def test_a_launch_file_sets_the_rate(graph: Graph, space: str) -> None:
    config = f'source = "{graph.source}"\n' + topic(f"{space}/pose", STAMPED)
    bridge, peer = graph.bridge(config, "--ros-args", "-p", "rate:=0.01", "-p", "other:rate:=100"), graph.peer()
    peer.ask(do="advertise", topic=f"{space}/pose", type="geometry_msgs/msg/PoseStamped")
    assert peer.ask(do="connected", topic=f"{space}/pose") == 1
    peer.ask(do="publish", topic=f"{space}/pose", messages=[{}] * 20)
    bridge.counted(f"{space}/pose +1 passed, \\d+ rate limited")  # the limiter holds the newest message
