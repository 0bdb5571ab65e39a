"""Test peers of another QoS: a topic adopts the QoS of publishers, and an incompatible peer is a warning."""

from __future__ import annotations

from typing import Any

import pytest

from shmgen.live.classes import publisher, subscriber

from ..support.ros1 import wait_for
from ..support.ros2 import Graph
from .test_bridge import session, topic

POSE = "geometry_msgs/Pose"
both_backends = pytest.mark.parametrize("graph", ["jazzy", ("jazzy", "dds")], indirect=True)


def start(graph: Graph, *topics: str, arguments: tuple[str, ...] = ()) -> tuple[Any, Any]:
    config = f'source = "{graph.source}"\n[bridge]\ndiagnostics = 0.2\n'
    return graph.bridge(config + "".join(topics), *arguments), graph.peer()


def status(peer: Any, name: str, level: int) -> str:
    """Wait until the topic has the level in /diagnostics, and return its message."""
    messages: list[str] = []

    def has_level() -> bool:
        for message in peer.ask(do="take", topic="/diagnostics", count=100, timeout=0.3):
            for item in message["status"]:
                if item["name"].endswith(name) and item["level"] in (level, [level]):
                    messages.append(item["message"])
        return bool(messages)

    wait_for(has_level, f"level {level} of {name}")
    return messages[-1]


@both_backends
def test_best_effort_publisher_needs_no_configuration(graph: Graph, space: str) -> None:
    """Receive from a best effort publisher, such as a camera driver."""
    _, peer = start(graph, topic(f"{space}/pose", POSE, "depth = 64"))
    kind = session(graph).classes([POSE])["geometry_msgs/msg/Pose"]
    peer.ask(do="advertise", topic=f"{space}/pose", type="geometry_msgs/msg/Pose", reliable=False)
    assert peer.ask(do="connected", topic=f"{space}/pose") == 1
    with subscriber(kind, f"{space}/pose", 64) as reader:
        peer.ask(do="publish", topic=f"{space}/pose", messages=[{"position": {"x": 1.0}}] * 50, period=0.01)
        poses: list[Any] = []
        wait_for(lambda: poses.extend(reader.read_all()) or len(poses) == 50, "all", lambda: f"{len(poses)}")


@both_backends
def test_incompatible_qos_is_a_warning_while_the_peer_exists(graph: Graph, space: str) -> None:
    reliable = topic(f"{space}/pose", POSE, 'qos = "reliable"')
    out = topic(f"{space}/out", POSE, 'direction = "from_plc"')
    bridge, peer = start(graph, reliable, out)
    peer.ask(do="subscribe", topic="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")
    peer.ask(do="advertise", topic=f"{space}/pose", type="geometry_msgs/msg/Pose", reliable=False)
    peer.ask(do="subscribe", topic=f"{space}/out", type="geometry_msgs/msg/Pose", latch=True)
    message = status(peer, f"{space}/pose", 1)
    assert message.startswith("a publisher is best effort and volatile, and this topic reliable and volatile"), message
    assert 'Set qos = "best_effort" in shmgen.toml' in message
    assert "Set latch = true in shmgen.toml" in status(peer, f"{space}/out", 1)
    bridge.wait_for_line(f"^{space}/pose: a publisher is best effort")
    peer.ask(do="withdraw", topic=f"{space}/pose")
    status(peer, f"{space}/pose", 0)


@pytest.mark.parametrize(("arguments", "is_published"), [((), True), (("--disable-rosout-logs",), False)])
@pytest.mark.parametrize("graph", ["jazzy", "kilted"], indirect=True)
def test_warnings_of_the_bridge_arrive_on_rosout(
    graph: Graph, space: str, arguments: tuple[str, ...], is_published: bool
) -> None:
    """Send the line with the node's name to a subscriber that joins later."""
    config = f'source = "{graph.source}"\n' + topic(f"{space}/pose", POSE, 'qos = "reliable"')
    bridge, peer = graph.bridge(config, "--ros-args", "-r", "__ns:=/cell1", *arguments), graph.peer()
    peer.ask(do="advertise", topic=f"{space}/pose", type="geometry_msgs/msg/Pose", reliable=False)
    bridge.wait_for_line(f"^{space}/pose: a publisher is best effort")
    peer.ask(do="subscribe", topic="/rosout", type="rcl_interfaces/msg/Log", latch=True)

    def lines(seconds: float = 0.5) -> list[tuple[str, int]]:
        received = peer.ask(do="take", topic="/rosout", count=100, timeout=seconds)
        return [(log["name"], log["level"]) for log in received if 'Set qos = "best_effort"' in log["msg"]]

    if is_published:
        wait_for(lambda: lines() == [("cell1.shmgen_bridge", 30)], "the warning")
    else:
        assert lines(2.0) == []


@pytest.mark.parametrize("graph", ["jazzy"], indirect=True)
def test_parameters_override_the_qos(graph: Graph, space: str) -> None:
    """Apply parameters such as `qos_overrides.TOPIC.subscription.reliability`, as every ROS 2 node does."""
    name = f"qos_overrides.{space}/out.publisher"
    arguments = ("--ros-args", "-p", f"{name}.durability:=transient_local", "-p", f"{name}.depth:=1")
    bridge, peer = start(graph, topic(f"{space}/out", POSE, 'direction = "from_plc"'), arguments=arguments)
    kind = session(graph).classes([POSE])["geometry_msgs/msg/Pose"]
    with publisher(kind, f"{space}/out", 1) as writer:
        sample = kind()
        sample.position.x = 4.5
        writer.publish(sample)
        bridge.counted("1 passed")
        peer.ask(do="subscribe", topic=f"{space}/out", type="geometry_msgs/msg/Pose", latch=True)
        (pose,) = peer.ask(do="take", topic=f"{space}/out", count=1)
    assert pose["position"]["x"] == 4.5
