"""The package that `-t ros2_cpp` writes, built against rclcpp itself: its node between rclpy's nodes and regions."""

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

from shmgen.live.classes import client, publisher, subscriber
from shmgen.runtime import CallFailed

from ..support import rclcpp
from ..support.ros1 import PROMPTLY, wait_for
from ..support.ros2 import Graph
from ..support.schemas import plain, random_message
from .test_bridge import SET_BOOL, crosses_dds, installed, monkeypatched, plc_server, session, topic
from .test_identity import ACCEPTS, OTHERS, stranger, wire

__all__ = ["stranger"]  # a fixture

pytestmark = [pytest.mark.slow, pytest.mark.parametrize("graph", ["jazzy"], indirect=True)]

FROM = 'direction = "from_plc"'
CONFIG = """source = "jazzy"
ros_package = "cell_bridge"
[types]
time = "struct"
[bounds]
"sensor_msgs/JointState" = 8
[bridge]
diagnostics = 0.2
"""


def cell(space: str) -> str:
    return (
        CONFIG
        + topic(f"{space}/pose", "geometry_msgs/PoseStamped", "depth = 60")
        + topic(f"{space}/joints", "sensor_msgs/JointState", "stale = 0.4")
        + topic(f"{space}/paced", "std_msgs/Int32", "rate = 10")
        + topic(f"{space}/speed", "std_msgs/Float64", FROM, "depth = 60")
        + topic(f"{space}/state", "std_msgs/Header", FROM, "latch = true")
        + SET_BOOL.format(space=space, server="plc", timeout=1)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=2)
    )


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[rclcpp.Node]:
    name = f"t{uuid.uuid4().hex[:12]}"
    yield rclcpp.Node(tmp_path_factory.mktemp("cell"), f"/{name}", cell(f"/{name}"))
    for file in Path("/dev/shm").glob(f"*{name}.*"):
        file.unlink()


def status(peer: Any, name: str) -> dict[str, Any]:
    """What the newest diagnostics say of a topic."""
    while arrays := peer.ask(do="take", topic="/diagnostics", count=1):
        found = [one for one in arrays[0]["status"] if one["name"].endswith(f": {name}")]
        if found:
            return found[0] | {pair["key"]: pair["value"] for pair in found[0]["values"]}
    raise AssertionError("no diagnostics")


def test_topics_both_ways(graph: Graph, built: rclcpp.Node) -> None:
    node, peer, space = built.start(graph), graph.peer(), built.space
    kinds = session(graph).classes(["geometry_msgs/PoseStamped", "std_msgs/Float64", "std_msgs/Header"])
    peer.ask(do="advertise", topic=f"{space}/pose", type="geometry_msgs/msg/PoseStamped")
    peer.ask(do="subscribe", topic=f"{space}/speed", type="std_msgs/msg/Float64")
    assert peer.ask(do="connected", topic=f"{space}/pose") == 1
    assert peer.ask(do="heard", topic=f"{space}/speed") == 1
    sent = [{"header": {"stamp": {"sec": 7, "nanosec": n}}, "pose": {"position": {"x": n + 0.5}}} for n in range(500)]
    with (
        subscriber(kinds["geometry_msgs/msg/PoseStamped"], f"{space}/pose", 60) as reader,
        publisher(kinds["std_msgs/msg/Float64"], f"{space}/speed", 60) as writer,
        publisher(kinds["std_msgs/msg/Header"], f"{space}/state", 1) as state,
    ):
        came: list[Any] = []
        publishing = threading.Thread(
            target=lambda: peer.ask(do="publish", topic=f"{space}/pose", messages=sent, period=0.001)
        )
        publishing.start()
        wait_for(lambda: came.extend(reader.read_all()) or len(came) >= len(sent), "all poses")
        publishing.join()
        assert [(it.header.stamp.nanosec, it.pose.position.x) for it in came] == [(n, n + 0.5) for n in range(500)]
        for number in range(500):
            writer.publish(SimpleNamespace(data=float(number)))
            time.sleep(0.001)
        assert [it["data"] for it in peer.ask(do="take", topic=f"{space}/speed", count=500)] == list(range(500))
        state.publish(SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="now"))
        time.sleep(0.5)
        peer.ask(do="subscribe", topic=f"{space}/state", type="std_msgs/msg/Header", latch=True)
        (late,) = peer.ask(do="take", topic=f"{space}/state", count=1)
        assert late["frame_id"] == "now"
        assert abs(late["stamp"]["sec"] - time.time()) < 60
    assert node.stop(signal.SIGINT) < PROMPTLY
    node.wait_for_line(f"{space}/pose: 500 passed$")
    node.wait_for_line(f"{space}/speed: 500 passed$")


def test_what_does_not_fit_is_refused_and_the_node_goes_on(graph: Graph, built: rclcpp.Node) -> None:
    node, peer, name = built.start(graph), graph.peer(), f"{built.space}/joints"
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


def test_a_rate_keeps_the_last_of_a_burst(graph: Graph, built: rclcpp.Node) -> None:
    node, peer, name = built.start(graph), graph.peer(), f"{built.space}/paced"
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


def test_services_both_ways(graph: Graph, built: rclcpp.Node) -> None:
    node, peer, other, space = built.start(graph), graph.peer(), graph.peer(), built.space
    asked = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {"data": True}}
    kinds = session(graph).classes(["std_srvs/SetBool"])
    calling = client(kinds["std_srvs/srv/SetBool_Request"], kinds["std_srvs/srv/SetBool_Reply"])

    def handler(request: Any) -> Any:
        return SimpleNamespace(success=request.data, message="of the PLC")

    with calling(f"{space}/of/flag") as plc:
        with pytest.raises(CallFailed):  # nobody serves it in ROS
            plc.call(SimpleNamespace(data=True), 5)
        other.ask(do="serve", service=f"{space}/of/flag", type="std_srvs/srv/SetBool", answers=[{"message": "of ROS"}])
        assert plc.call(SimpleNamespace(data=True), 10).message == "of ROS"
    assert peer.ask(**asked, timeout=2) == "no answer"  # no PLC is there
    with plc_server(graph, f"{space}/flag", handler):
        assert peer.ask(**asked) == {"success": True, "message": "of the PLC"}
    node.stop(signal.SIGTERM)
    node.wait_for_line("t[0-9a-f]+/flag: 1 passed, 1 failed$")
    node.wait_for_line("of/flag: 1 passed, 1 failed$")


def test_it_is_a_lifecycle_node_with_parameters(graph: Graph, built: rclcpp.Node) -> None:
    name = f"{built.space}/pose"
    parameter = f"{name.removeprefix('/').replace('/', '.')}.region"
    more = ("--ros-args", "-p", f"{parameter}:={built.space}/elsewhere", "-r", f"{name}:={built.space}/other")
    node, peer = built.start(graph, *more), graph.peer()
    kind = session(graph).classes(["geometry_msgs/PoseStamped"])["geometry_msgs/msg/PoseStamped"]
    peer.ask(do="advertise", topic=f"{built.space}/other", type="geometry_msgs/msg/PoseStamped")
    assert peer.ask(do="connected", topic=f"{built.space}/other") == 1
    change = {"do": "call", "service": "/shmgen_bridge/change_state", "type": "lifecycle_msgs/srv/ChangeState"}

    def send(number: int) -> None:
        values = {"pose": {"position": {"x": float(number)}}}
        peer.ask(do="publish", topic=f"{built.space}/other", messages=[values])

    with subscriber(kind, f"{built.space}/elsewhere", 60) as reader:
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


def test_a_signal_in_the_midst_of_a_callback_is_no_crash(graph: Graph, built: rclcpp.Node) -> None:
    for number in range(12):
        node = built.start(graph, "--ros-args", "-p", "diagnostics:=0.0005")  # asks for its peers all the time
        time.sleep(number / 1000)
        node.stop(signal.SIGTERM)  # is sure that it ended with 0


def test_it_is_killed_and_its_regions_are_removed(graph: Graph, built: rclcpp.Node) -> None:
    node, peer, name = built.start(graph), graph.peer(), f"{built.space}/pose"
    kind = session(graph).classes(["geometry_msgs/PoseStamped"])["geometry_msgs/msg/PoseStamped"]
    peer.ask(do="advertise", topic=name, type="geometry_msgs/msg/PoseStamped")
    sent: list[float] = []

    def crosses(reader: Any) -> bool:
        sent.append(len(sent) + 1.0)
        peer.ask(do="publish", topic=name, messages=[{"pose": {"position": {"x": sent[-1]}}}])
        sample = reader.wait(0.3)
        return sample is not None and sample.pose.position.x == sent[-1]

    with subscriber(kind, name, 60) as reader:
        wait_for(lambda: crosses(reader), "a pose")
        node.kill()
        assert not reader.is_stale(0.3)
        wait_for(lambda: reader.is_stale(0.3), "no heartbeat")
        node = built.start(graph)
        wait_for(lambda: crosses(reader), "a pose of the next")
    for file in Path("/dev/shm").glob(f"*{built.space[1:]}.pose*"):
        file.unlink()
    with subscriber(kind, name, 60) as reader:
        wait_for(lambda: crosses(reader), "a pose in the region made anew")
    node.stop(signal.SIGTERM)


def test_another_definition_is_no_value(graph: Graph, stranger: Any, space: str, tmp_path: Path) -> None:
    definitions = {"same": "float64 x\nfloat64 y\nfloat64 z\n", "accepted": OTHERS["renamed"], **OTHERS}
    topics = (topic(f"{space}/{name}", "geometry_msgs/Vector3") + ACCEPTS.get(name, "") for name in definitions)
    node = rclcpp.Node(tmp_path / "package", space, CONFIG + "".join(topics)).start(graph)
    kind = session(graph).classes(["geometry_msgs/Vector3"])["geometry_msgs/msg/Vector3"]
    outlets = {
        name: stranger.publisher(wire(tmp_path / name, f"{space}/{name}", text)) for name, text in definitions.items()
    }
    with ExitStack() as stack:
        readers = {name: stack.enter_context(subscriber(kind, f"{space}/{name}", 1)) for name in definitions}
        came: set[str] = set()

        def sent() -> bool:
            for outlet in outlets.values():
                outlet.send(outlet.new())
            time.sleep(0.1)
            came.update(name for name, reader in readers.items() if reader.read() is not None)
            told = [name for name in OTHERS if any(f"{name}: refused: " in line for line in list(node.lines))]
            return {"same", "accepted"} <= came and len(told) == len(OTHERS)

        wait_for(sent, "a refusal of each", lambda: "".join(node.lines))
    assert came == {"same", "accepted"}
    node.stop(signal.SIGTERM)
    node.wait_for_line(rf"{space}/renamed: 0 passed, \d+ refused$")
    node.wait_for_line(rf"{space}/accepted: \d+ passed$")


PARTS = 16
"""So many packages for all messages: rclcpp takes three seconds to compile for each."""


@pytest.mark.timeout(900)
@pytest.mark.parametrize("part", range(PARTS))
def test_every_message_there_and_back(graph: Graph, space: str, tmp_path: Path, part: int) -> None:
    """rclpy, the node, a region, the node, rclpy: unchanged, field by field, for all messages of a distribution."""
    names = [name for name in installed(graph) if crosses_dds(graph, name)][part::PARTS]
    ends = list(enumerate(names))
    config = CONFIG.replace("jazzy", "env").partition("[bounds]")[0] + "[strings]\ndefault = 40\n[bounds]\n"
    config += "".join(f"{package} = 3\n" for package in sorted({name.split("/")[0] for name in names}))
    config += "[bridge]\ndiagnostics = 0\n"
    config += "".join(topic(f"{space}/there{number}", name) for number, name in ends)
    config += "".join(topic(f"{space}/back{number}", name, FROM, 'stamp = "keep"') for number, name in ends)
    with monkeypatched(graph):
        node = rclcpp.Node(tmp_path / "package", space, config, "None").start(graph)
        made = session(graph)
        layouts, kinds = made.layouts(names), made.classes(names)
    peer = graph.peer()
    for number, name in ends:
        peer.ask(do="advertise", topic=f"{space}/there{number}", type=name)
        peer.ask(do="subscribe", topic=f"{space}/back{number}", type=name)
    wrong = []
    for number, name in ends:
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
