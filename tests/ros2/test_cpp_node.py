"""Test the package of `-t ros2_cpp`, built against rclcpp: its node between rclpy nodes and regions."""

from __future__ import annotations

import json
import random
import signal
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.live.classes import publisher, subscriber
from shmgen.runtime import CallFailed, ServiceClient

from ..support import rclcpp
from ..support.ros1 import PROMPTLY, wait_for
from ..support.ros2 import Graph
from ..support.schemas import plain, random_message
from .test_bridge import SET_BOOL, is_dds_type, message_types, plc_server, ros_environment, session, set_bool, topic
from .test_identity import ACCEPT_KEYS, OTHERS, dds_peer, wire

__all__ = ["dds_peer"]  # a fixture

pytestmark = [pytest.mark.slow, pytest.mark.parametrize("graph", ["jazzy"], indirect=True)]

FROM_PLC = 'direction = "from_plc"'
CONFIG = """source = "jazzy"
ros_package = "cell_bridge"
[types]
time = "struct"
[bounds]
"sensor_msgs/JointState" = 8
[bridge]
diagnostics = 0.2
"""


def config_text(space: str) -> str:
    return (
        CONFIG
        + topic(f"{space}/pose", "geometry_msgs/PoseStamped", "depth = 60")
        + topic(f"{space}/joints", "sensor_msgs/JointState", "stale = 0.4")
        + topic(f"{space}/paced", "std_msgs/Int32", "rate = 10")
        + topic(f"{space}/speed", "std_msgs/Float64", FROM_PLC, "depth = 60")
        + topic(f"{space}/state", "std_msgs/Header", FROM_PLC, "latch = true")
        + SET_BOOL.format(space=space, server="plc", timeout=1)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=2)
    )


@pytest.fixture(scope="module")
def cpp_node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[rclcpp.Node]:
    name = f"t{uuid.uuid4().hex[:12]}"
    yield rclcpp.Node(tmp_path_factory.mktemp("cell"), f"/{name}", config_text(f"/{name}"))
    for file in Path("/dev/shm").glob(f"*{name}.*"):
        file.unlink()


def status(peer: Any, name: str) -> dict[str, Any]:
    """Return the newest diagnostics of a topic."""
    while arrays := peer.ask(do="take", topic="/diagnostics", count=1):
        statuses = [status_ for status_ in arrays[0]["status"] if status_["name"].endswith(f": {name}")]
        if statuses:
            return statuses[0] | {pair["key"]: pair["value"] for pair in statuses[0]["values"]}
    raise AssertionError("no diagnostics")


def test_topics_pass_both_ways(graph: Graph, cpp_node: rclcpp.Node) -> None:
    node, peer, space = cpp_node.start(graph), graph.peer(), cpp_node.space
    kinds = session(graph).classes(["geometry_msgs/PoseStamped", "std_msgs/Float64", "std_msgs/Header"])
    peer.ask(do="advertise", topic=f"{space}/pose", type="geometry_msgs/msg/PoseStamped")
    peer.ask(do="subscribe", topic=f"{space}/speed", type="std_msgs/msg/Float64")
    assert peer.ask(do="connected", topic=f"{space}/pose") == 1
    assert peer.ask(do="wait_for_publisher", topic=f"{space}/speed") == 1
    sent = [{"header": {"stamp": {"sec": 7, "nanosec": n}}, "pose": {"position": {"x": n + 0.5}}} for n in range(500)]
    with (
        subscriber(kinds["geometry_msgs/msg/PoseStamped"], f"{space}/pose", 60) as reader,
        publisher(kinds["std_msgs/msg/Float64"], f"{space}/speed", 60) as writer,
        publisher(kinds["std_msgs/msg/Header"], f"{space}/state", 1) as state,
    ):
        poses: list[Any] = []
        thread = threading.Thread(
            target=lambda: peer.ask(do="publish", topic=f"{space}/pose", messages=sent, period=0.001)
        )
        thread.start()
        wait_for(lambda: poses.extend(reader.read_all()) or len(poses) >= len(sent), "all poses")
        thread.join()
        assert [(it.header.stamp.nanosec, it.pose.position.x) for it in poses] == [(n, n + 0.5) for n in range(500)]
        for number in range(500):
            writer.publish(SimpleNamespace(data=float(number)))
            time.sleep(0.001)
        assert [speed["data"] for speed in peer.ask(do="take", topic=f"{space}/speed", count=500)] == list(range(500))
        state.publish(SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="now"))
        time.sleep(0.5)
        peer.ask(do="subscribe", topic=f"{space}/state", type="std_msgs/msg/Header", latch=True)
        (latched,) = peer.ask(do="take", topic=f"{space}/state", count=1)
        assert latched["frame_id"] == "now"
        assert abs(latched["stamp"]["sec"] - time.time()) < 60
    assert node.stop(signal.SIGINT) < PROMPTLY
    node.wait_for_line(f"{space}/pose: 500 passed$")
    node.wait_for_line(f"{space}/speed: 500 passed$")


def test_rejected_messages_do_not_stop_the_node(graph: Graph, cpp_node: rclcpp.Node) -> None:
    node, peer, name = cpp_node.start(graph), graph.peer(), f"{cpp_node.space}/joints"
    kind = session(graph).classes(["sensor_msgs/JointState"])["sensor_msgs/msg/JointState"]
    peer.ask(do="advertise", topic=name, type="sensor_msgs/msg/JointState")
    peer.ask(do="subscribe", topic="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")
    assert peer.ask(do="connected", topic=name) == 1
    with subscriber(kind, name, 1) as reader:
        eight, nine = {"position": [1.5] * 8}, {"position": [2.5] * 9}
        peer.ask(do="publish", topic=name, messages=[eight, nine, {"name": ["x" * 81]}], period=0.05)
        wait_for(lambda: status(peer, name)["rejected"] == "2", "two that do not fit")
        assert list(reader.read().position) == [1.5] * 8
        assert reader.read() is None
        node.wait_for_line("joints: rejected: position: ")
        assert not reader.is_stale(5)
        wait_for(lambda: status(peer, name)["level"] == 3, "STALE")
        wait_for(lambda: reader.is_stale(0.3), "the heartbeat to stand still")
    node.stop(signal.SIGTERM)
    node.wait_for_line("joints: 1 passed, 2 rejected$")


def test_rate_passes_the_last_message_of_a_burst(graph: Graph, cpp_node: rclcpp.Node) -> None:
    node, peer, name = cpp_node.start(graph), graph.peer(), f"{cpp_node.space}/paced"
    kind = session(graph).classes(["std_msgs/Int32"])["std_msgs/msg/Int32"]
    peer.ask(do="advertise", topic=name, type="std_msgs/msg/Int32")
    assert peer.ask(do="connected", topic=name) == 1
    with subscriber(kind, name, 1) as reader:
        peer.ask(do="publish", topic=name, messages=[{"data": number} for number in range(1, 101)], period=0.005)
        wait_for(lambda: (sample := reader.read()) and sample.data == 100, "the last one")
        assert reader.missed + 1 < 15
    node.stop(signal.SIGTERM)
    words = node.wait_for_line("paced: ").split()
    assert int(words[-5]) + int(words[-3]) == 100, words
    assert words[-2:] == ["rate", "limited"]


def test_services_pass_both_ways(graph: Graph, cpp_node: rclcpp.Node) -> None:
    node, peer, other, space = cpp_node.start(graph), graph.peer(), graph.peer(), cpp_node.space
    command = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {"data": True}}
    set_bool_client = set_bool(graph, ServiceClient)

    def handler(request: Any) -> Any:
        return SimpleNamespace(success=request.data, message="of the PLC")

    with set_bool_client(f"{space}/of/flag") as plc:
        with pytest.raises(CallFailed):  # ROS has no server yet
            plc.call(SimpleNamespace(data=True), 5)
        other.ask(do="serve", service=f"{space}/of/flag", type="std_srvs/srv/SetBool", answers=[{"message": "of ROS"}])
        assert plc.call(SimpleNamespace(data=True), 10).message == "of ROS"
    assert peer.ask(**command, timeout=2) == "no answer"  # no PLC serves it yet
    with plc_server(graph, f"{space}/flag", handler):
        assert peer.ask(**command) == {"success": True, "message": "of the PLC"}
    node.stop(signal.SIGTERM)
    node.wait_for_line("t[0-9a-f]+/flag: 1 passed, 1 failed$")
    node.wait_for_line("of/flag: 1 passed, 1 failed$")


def test_node_has_a_lifecycle_and_parameters(graph: Graph, cpp_node: rclcpp.Node) -> None:
    name = f"{cpp_node.space}/pose"
    parameter = f"{name.removeprefix('/').replace('/', '.')}.region"
    more = ("--ros-args", "-p", f"{parameter}:={cpp_node.space}/elsewhere", "-r", f"{name}:={cpp_node.space}/other")
    node, peer = cpp_node.start(graph, *more), graph.peer()
    kind = session(graph).classes(["geometry_msgs/PoseStamped"])["geometry_msgs/msg/PoseStamped"]
    peer.ask(do="advertise", topic=f"{cpp_node.space}/other", type="geometry_msgs/msg/PoseStamped")
    assert peer.ask(do="connected", topic=f"{cpp_node.space}/other") == 1
    change = {"do": "call", "service": "/shmgen_bridge/change_state", "type": "lifecycle_msgs/srv/ChangeState"}

    def send(number: int) -> None:
        values = {"pose": {"position": {"x": float(number)}}}
        peer.ask(do="publish", topic=f"{cpp_node.space}/other", messages=[values])

    with subscriber(kind, f"{cpp_node.space}/elsewhere", 60) as reader:
        send(1)
        assert reader.wait(10).pose.position.x == 1
        assert peer.ask(**change, request={"transition": {"id": 4}}) == {"success": True}
        send(2)
        time.sleep(0.5)
        assert reader.read() is None
        wait_for(lambda: reader.is_stale(0.3), "no heartbeat")
        assert peer.ask(**change, request={"transition": {"id": 3}}) == {"success": True}
        send(3)
        assert reader.wait(10).pose.position.x == 3
        assert peer.ask(**change, request={"transition": {"id": 4}}) == {"success": True}
        assert peer.ask(**change, request={"transition": {"id": 2}}) == {"success": True}
    node.stop(signal.SIGTERM)


def test_signal_during_a_callback_does_not_crash_the_node(graph: Graph, cpp_node: rclcpp.Node) -> None:
    for number in range(12):
        node = cpp_node.start(graph, "--ros-args", "-p", "diagnostics:=0.0005")  # queries its peers continuously
        time.sleep(number / 1000)
        node.stop(signal.SIGTERM)  # requires exit code 0


def test_topic_recovers_from_a_killed_node_and_removed_regions(graph: Graph, cpp_node: rclcpp.Node) -> None:
    node, peer, name = cpp_node.start(graph), graph.peer(), f"{cpp_node.space}/pose"
    kind = session(graph).classes(["geometry_msgs/PoseStamped"])["geometry_msgs/msg/PoseStamped"]
    peer.ask(do="advertise", topic=name, type="geometry_msgs/msg/PoseStamped")
    sent: list[float] = []

    def message_passes(reader: Any) -> bool:
        sent.append(len(sent) + 1.0)
        peer.ask(do="publish", topic=name, messages=[{"pose": {"position": {"x": sent[-1]}}}])
        sample = reader.wait(0.3)
        return sample is not None and sample.pose.position.x == sent[-1]

    with subscriber(kind, name, 60) as reader:
        wait_for(lambda: message_passes(reader), "a pose")
        node.kill()
        assert not reader.is_stale(0.3)
        wait_for(lambda: reader.is_stale(0.3), "no heartbeat")
        node = cpp_node.start(graph)
        wait_for(lambda: message_passes(reader), "a pose of the next")
    for file in Path("/dev/shm").glob(f"*{cpp_node.space[1:]}.pose*"):
        file.unlink()
    with subscriber(kind, name, 60) as reader:
        wait_for(lambda: message_passes(reader), "a pose in the recreated region")
    node.stop(signal.SIGTERM)


def test_another_definition_is_refused(graph: Graph, dds_peer: Any, space: str, tmp_path: Path) -> None:
    definitions = {"same": "float64 x\nfloat64 y\nfloat64 z\n", "accepted": OTHERS["renamed"], **OTHERS}
    topics = (topic(f"{space}/{name}", "geometry_msgs/Vector3") + ACCEPT_KEYS.get(name, "") for name in definitions)
    node = rclcpp.Node(tmp_path / "package", space, CONFIG + "".join(topics)).start(graph)
    kind = session(graph).classes(["geometry_msgs/Vector3"])["geometry_msgs/msg/Vector3"]
    outlets = {
        name: dds_peer.publisher(wire(tmp_path / name, f"{space}/{name}", text)) for name, text in definitions.items()
    }
    with ExitStack() as stack:
        readers = {name: stack.enter_context(subscriber(kind, f"{space}/{name}", 1)) for name in definitions}
        received: set[str] = set()

        def all_are_known() -> bool:
            for outlet in outlets.values():
                outlet.send(outlet.new())
            time.sleep(0.1)
            received.update(name for name, reader in readers.items() if reader.read() is not None)
            refused = [name for name in OTHERS if any(f"{name}: refused: " in line for line in list(node.lines))]
            return {"same", "accepted"} <= received and len(refused) == len(OTHERS)

        wait_for(all_are_known, "a refusal of each", lambda: "".join(node.lines))
    assert received == {"same", "accepted"}
    node.stop(signal.SIGTERM)
    node.wait_for_line(rf"{space}/renamed: 0 passed, \d+ refused$")
    node.wait_for_line(rf"{space}/accepted: \d+ passed$")


PARTS = 16
"""The number of packages that share all message types: rclcpp takes three seconds to compile each type."""


@pytest.mark.timeout(900)
@pytest.mark.parametrize("part", range(PARTS))
def test_every_message_type_passes_both_ways_unchanged(graph: Graph, space: str, tmp_path: Path, part: int) -> None:
    """Pass each type of a distribution from rclpy through the node to a region and back, and compare all fields."""
    names = [name for name in message_types(graph) if is_dds_type(graph, name)][part::PARTS]
    pairs = list(enumerate(names))
    config = CONFIG.replace("jazzy", "env").partition("[bounds]")[0] + "[strings]\ndefault = 40\n[bounds]\n"
    config += "".join(f"{package} = 3\n" for package in sorted({name.split("/")[0] for name in names}))
    config += "[bridge]\ndiagnostics = 0\n"
    config += "".join(topic(f"{space}/there{number}", name) for number, name in pairs)
    config += "".join(topic(f"{space}/back{number}", name, FROM_PLC, 'stamp = "keep"') for number, name in pairs)
    with ros_environment(graph):
        node = rclcpp.Node(tmp_path / "package", space, config, "None").start(graph)
        schema_session = session(graph)
        layouts, kinds = schema_session.layouts(names), schema_session.classes(names)
    peer = graph.peer()
    for number, name in pairs:
        peer.ask(do="advertise", topic=f"{space}/there{number}", type=name)
        peer.ask(do="subscribe", topic=f"{space}/back{number}", type=name)
    wrong = []
    for number, name in pairs:
        assert peer.ask(do="connected", topic=f"{space}/there{number}") == 1, name
        layout = next(layout for layout in layouts.values() if str(layout.name) == name)
        sent = [plain(random_message(layout, layouts, random.Random(f"{name}{seed}"))) for seed in range(2)]
        with (
            subscriber(kinds[name], f"{space}/there{number}", 1) as reader,
            publisher(kinds[name], f"{space}/back{number}", 1) as writer,
        ):
            for values in sent:
                peer.ask(do="publish", topic=f"{space}/there{number}", messages=[values])
                sample = reader.wait(10)
                assert sample is not None, f"{name}\n{''.join(node.lines)}"
                writer.publish(sample)
                (back,) = peer.ask(do="take", topic=f"{space}/back{number}", count=1) or [None]
                if json.dumps(back) != json.dumps(values):
                    wrong.append((name, values, back))
    assert wrong == []
    node.stop(signal.SIGTERM)
