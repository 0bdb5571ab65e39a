"""Test `shmgen bridge` between rclpy nodes and regions in separate processes, with the backends ros2 and dds."""

from __future__ import annotations

import json
import random
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import call_class, publisher, subscriber
from shmgen.live.session import Session
from shmgen.runtime import ServiceClient, ServiceServer, ShmError

from ..support.dds import without_fast_dds
from ..support.ros1 import PROMPTLY, wait_for
from ..support.ros2 import Graph
from ..support.schemas import plain, random_message

BACKENDS = [(distribution, backend) for distribution in ("jazzy", "kilted") for backend in ("ros2", "dds")]
all_backends = pytest.mark.parametrize("graph", BACKENDS, indirect=True, ids="-".join)
rclpy_only = pytest.mark.parametrize("graph", [("jazzy", "ros2"), ("kilted", "ros2")], indirect=True, ids="-".join)

SET_BOOL = """
[[services]]
service = "{space}/flag"
type = "std_srvs/SetBool"
server = "{server}"
timeout = {timeout}
"""


def topic(name: str, type_: str, *keys: str) -> str:
    return "\n".join(["[[topics]]", f'topic = "{name}"', f'type = "{type_}"', *keys, ""])


def session(graph: Graph) -> Session:
    """Return a session for the bridge's shmgen.toml."""
    return Session(load(graph.folder / "shmgen.toml", "shmgen.toml", Report()))


def set_bool(graph: Graph, end: type[Any]) -> Any:
    """Return the subclass of a client or server class for std_srvs/SetBool."""
    kinds = session(graph).classes(["std_srvs/SetBool"])
    return call_class(end, {part: kinds[f"std_srvs/srv/SetBool{part}"] for part in ("_Request", "_Reply")})


@contextmanager
def plc_server(graph: Graph, name: str, handler: Callable[[Any], Any]) -> Iterator[None]:
    """Serve std_srvs/SetBool in a thread, as a PLC does."""
    server_class = set_bool(graph, ServiceServer)
    stop = threading.Event()

    def run() -> None:
        with server_class(name) as served:
            while not stop.is_set():
                served.serve(handler, timeout=0.05)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@pytest.mark.sample("[jazzy-ros2]")
@pytest.mark.parametrize(
    "graph", [backend for backend in BACKENDS if backend != ("kilted", "dds")], indirect=True, ids="-".join
)
def test_every_message_type_passes_both_ways_unchanged(graph: Graph, space: str) -> None:
    """Pass each type from rclpy to a region and back, and compare all fields."""
    source = graph.source
    config = 'source = "env"\n[types]\ntime = "struct"\n[strings]\ndefault = 40\n'
    (graph.folder / "shmgen.toml").write_text(config)
    names = [name for name in message_types(graph) if graph.backend == "ros2" or is_dds_type(graph, name)]
    assert len(names) > 120, source
    config += "[bounds]\n" + "".join(f"{package} = 3\n" for package in sorted({name.split("/")[0] for name in names}))
    pairs = list(enumerate(names))
    config += "".join(topic(f"{space}/there{number}", name) for number, name in pairs)
    config += "".join(topic(f"{space}/back{number}", name, 'direction = "from_plc"') for number, name in pairs)
    bridge = graph.bridge(config)
    peer = graph.peer()
    with ros_environment(graph):
        schema_session = session(graph)
        layouts, kinds = schema_session.layouts(names), schema_session.classes(names)
    for number, name in pairs:
        peer.ask(do="advertise", topic=f"{space}/there{number}", type=name)
        peer.ask(do="subscribe", topic=f"{space}/back{number}", type=name)
    wrong = []
    for number, name in pairs:
        assert peer.ask(do="connected", topic=f"{space}/there{number}") == 1, name
        layout = next(layout for layout in layouts.values() if str(layout.name) == name)
        sent = [plain(random_message(layout, layouts, random.Random(f"{name}{seed}"))) for seed in range(2)]
        with ExitStack() as stack:
            reader = stack.enter_context(subscriber(kinds[name], f"{space}/there{number}", 1))
            writer = stack.enter_context(publisher(kinds[name], f"{space}/back{number}", 1))
            for values in sent:
                peer.ask(do="publish", topic=f"{space}/there{number}", messages=[values])
                sample = reader.wait(10)
                assert sample is not None, f"{name}\n{''.join(bridge.lines)}"
                writer.publish(sample)
                (back,) = peer.ask(do="take", topic=f"{space}/back{number}", count=1) or [None]
                if json.dumps(back) != json.dumps(values):
                    wrong.append((name, values, back))
    assert wrong == []
    bridge.stop(signal.SIGTERM)


def is_dds_type(graph: Graph, name: str) -> bool:
    """Return False for a type with wstrings, or with a key in its .idl: DDS treats keyed topics as another kind."""
    package, kind, bare = name.split("/")
    definition = graph.prefix / "share" / package / kind / f"{bare}.idl"
    return bare != "WStrings" and "@key" not in definition.read_text()


def message_types(graph: Graph) -> list[str]:
    """Return all message types of the installed packages that a topic may have."""
    files = graph.prefix.glob("share/*/msg/*.json")
    return sorted(f"{file.parts[-3]}/msg/{file.stem}" for file in files if file.parts[-3] != "builtin_interfaces")


@contextmanager
def ros_environment(graph: Graph) -> Iterator[None]:
    """Set the environment of this process as if the graph's ROS were sourced."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AMENT_PREFIX_PATH", str(graph.prefix))
        patch.setenv("ROS_VERSION", "2")
        yield


@all_backends
def test_waiting_call_blocks_no_topic_and_no_other_call(graph: Graph, space: str) -> None:
    """Pass messages and another call while a call waits for the PLC."""
    if graph.backend == "dds":
        without_fast_dds()
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + topic(f"{space}/pose", "geometry_msgs/Pose", "depth = 50")
        + SET_BOOL.format(space=space, server="plc", timeout=30)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=10)
    )
    peer, other = graph.peer(), graph.peer()
    peer.ask(do="advertise", topic=f"{space}/pose", type="geometry_msgs/msg/Pose")
    other.ask(do="serve", service=f"{space}/of/flag", type="std_srvs/srv/SetBool", answers=[{"message": "of ROS"}] * 5)
    assert peer.ask(do="connected", topic=f"{space}/pose") == 1
    go = threading.Event()

    def handler(request: Any) -> Any:
        go.wait(30)
        return SimpleNamespace(success=request.data, message="of the PLC")

    kinds = session(graph).classes(["geometry_msgs/Pose"])
    set_bool_client = set_bool(graph, ServiceClient)
    with (
        plc_server(graph, f"{space}/flag", handler),
        set_bool_client(f"{space}/of/flag") as plc,
        subscriber(kinds["geometry_msgs/msg/Pose"], f"{space}/pose", 50) as reader,
    ):
        answers: list[Any] = []
        query: dict[str, Any] = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool"}
        query |= {"request": {"data": True}, "timeout": 30}
        thread = threading.Thread(target=lambda: answers.append(other.ask(**query)))
        thread.start()
        time.sleep(0.5)
        started_at = time.monotonic()
        for number in range(10):
            peer.ask(do="publish", topic=f"{space}/pose", messages=[{"position": {"x": float(number)}}])
            assert reader.wait(5).position.x == number
        assert plc.call(SimpleNamespace(data=True), 10).message == "of ROS"
        assert time.monotonic() - started_at < 10
        assert answers == []
        go.set()
        thread.join()
    assert answers == [{"success": True, "message": "of the PLC"}]
    assert bridge.stop(signal.SIGTERM) < PROMPTLY
    assert not [line for line in bridge.lines if "Error" in line or "never retrieved" in line]


def call(plc: Any) -> str:
    try:
        return str(plc.call(SimpleNamespace(data=True), 3).message)
    except ShmError as error:
        return str(error)


@all_backends
def test_bridge_stops_promptly_during_calls(graph: Graph, space: str) -> None:
    if graph.backend == "dds":
        without_fast_dds()
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + SET_BOOL.format(space=space, server="plc", timeout=20)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=20)
    )
    peer, other = graph.peer(), graph.peer()
    other.ask(do="serve", service=f"{space}/of/flag", type="std_srvs/srv/SetBool", answers=[], delay=20)
    set_bool_client = set_bool(graph, ServiceClient)
    request_received = threading.Event()
    stop = threading.Event()
    outcome: list[str] = []

    def handler(request: Any) -> Any:
        request_received.set()
        stop.wait(20)
        return SimpleNamespace(success=True, message="")

    with plc_server(graph, f"{space}/flag", handler), set_bool_client(f"{space}/of/flag") as plc:
        query = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {}, "timeout": 20}
        threading.Thread(target=lambda: peer.ask(**query), daemon=True).start()
        threading.Thread(target=lambda: outcome.append(call(plc)), daemon=True).start()
        assert request_received.wait(20)
        time.sleep(0.3)
        duration = bridge.stop(signal.SIGTERM)
        stop.set()
    assert duration < PROMPTLY
    assert not [line for line in bridge.lines if "rror" in line or "never retrieved" in line or "Traceback" in line]


@all_backends
def test_late_subscriber_receives_the_newest_message(graph: Graph, space: str) -> None:
    name = f"{space}/state"
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + topic(name, "std_msgs/Int32", 'direction = "from_plc"', "latch = true", "depth = 60")
    )
    kinds = session(graph).classes(["std_msgs/Int32"])
    with publisher(kinds["std_msgs/msg/Int32"], name, 60) as writer:
        for number in range(50):
            writer.publish(SimpleNamespace(data=number))
        bridge.counted(f"{name} +50 passed")
        peer = graph.peer()
        peer.ask(do="subscribe", topic=name, type="std_msgs/msg/Int32", latch=True)
        time.sleep(1)
        assert peer.ask(do="take", topic=name, count=1) == [{"data": 49}]
        assert peer.ask(do="take", topic=name, count=1, timeout=0.2) == []
    bridge.stop(signal.SIGTERM)
    bridge.wait_for_line(f"{name} +50 passed$")


@all_backends
def test_invalid_message_is_counted_as_rejected(graph: Graph, space: str) -> None:
    name = f"{space}/word"
    bridge = graph.bridge(f'source = "{graph.source}"\n' + topic(name, "std_msgs/String"))
    peer = graph.peer()
    peer.ask(do="advertise", topic=name, type="std_msgs/msg/String")
    assert peer.ask(do="connected", topic=name) == 1
    peer.ask(do="publish_raw", topic=name, messages=["00010000 02000000 fc00".replace(" ", "")])
    peer.ask(do="publish", topic=name, messages=[{"data": "fine"}])
    bridge.counted(f"{name} +1 passed, 1 rejected")
    bridge.stop(signal.SIGTERM)
    bridge.wait_for_line("utf-8")


@rclpy_only
def test_overwritten_messages_are_counted_as_lost(graph: Graph, space: str) -> None:
    name = f"{space}/fast"
    bridge = graph.bridge(f'source = "{graph.source}"\n' + topic(name, "std_msgs/Int32"))
    peer = graph.peer()
    peer.ask(do="advertise", topic=name, type="std_msgs/msg/Int32", depth=10)
    assert peer.ask(do="connected", topic=name) == 1
    kinds = session(graph).classes(["std_msgs/Int32"])
    with subscriber(kinds["std_msgs/msg/Int32"], name, 1) as reader:
        peer.ask(do="publish", topic=name, messages=[{"data": 0}])
        assert reader.wait(5).data == 0
        bridge.process.send_signal(signal.SIGSTOP)
        peer.ask(do="publish", topic=name, messages=[{"data": number} for number in range(1, 3001)])
        bridge.process.send_signal(signal.SIGCONT)
        wait_for(lambda: (sample := reader.read()) and sample.data == 3000, "the last message")
    bridge.stop(signal.SIGTERM)
    words = bridge.wait_for_line(f"{name} +\\d+ passed").split()
    passed = int(words[1])
    lost = int(words[words.index("lost") - 1]) if "lost" in words else 0
    assert passed + lost == 3001, words
    assert lost > 0


@rclpy_only
def test_bridge_follows_arguments_of_ros(graph: Graph, space: str) -> None:
    config = f'source = "{graph.source}"\n' + topic(f"{space}/word", "std_msgs/String")
    bridge = graph.bridge(
        config, "--ros-args", "-r", "__node:=cell_4", "-r", f"{space}/word:={space}/other", "-p", "use_sim_time:=true"
    )
    peer = graph.peer()
    peer.ask(do="advertise", topic=f"{space}/other", type="std_msgs/msg/String")
    assert peer.ask(do="connected", topic=f"{space}/other") == 1
    peer.ask(do="publish", topic=f"{space}/other", messages=[{"data": "a"}])
    assert peer.ask(do="wait_for_publisher", topic="/diagnostics") >= 1
    # The graph reports the name of a node later than the node.
    wait_for(lambda: "cell_4" in [info["node"] for info in peer.ask(do="graph", topic="/diagnostics")], "the name")
    bridge.counted(" 1 passed")
    bridge.stop(signal.SIGINT)
    refused = graph.bridge("", "--ros-args", "--no-such-thing", ready=False)
    assert refused.process.wait(30) == 1
    refused.wait_for_line("ros2: .*no-such-thing")
    assert "SHM901" not in "".join(refused.lines)


@rclpy_only
def test_another_definition_in_ros_ends_the_bridge(graph: Graph, space: str) -> None:
    file = graph.folder / "msgs" / "std_msgs" / "msg" / "Int32.msg"
    file.parent.mkdir(parents=True)
    file.write_text("float32 data\n")
    bridge = graph.bridge('path = ["msgs"]\n' + topic(f"{space}/x", "std_msgs/Int32"), ready=False)
    assert bridge.process.wait(30) == 1
    bridge.wait_for_line("std_msgs/msg/Int32 of this ROS has the fields int32 data; shmgen expects float data")


@rclpy_only
def test_diagnostics_are_published(graph: Graph, space: str) -> None:
    graph.bridge(f'source = "{graph.source}"\n[bridge]\ndiagnostics = 0.2\n' + topic(f"{space}/x", "std_msgs/Int32"))
    peer = graph.peer()
    peer.ask(do="subscribe", topic="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")
    (array,) = peer.ask(do="take", topic="/diagnostics", count=1)
    (status,) = array["status"]
    assert (status["name"], status["level"]) == (f"shmgen_bridge: {space}/x", 0)
    assert {"refused", "lost", "age [s]"} <= {value["key"] for value in status["values"]}
    wait_for(lambda: peer.ask(do="graph", topic="/diagnostics"), "diagnostics")
