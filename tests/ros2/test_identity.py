"""Test that messages of a peer with another definition never reach the PLC, for every kind of difference."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("cyclonedds", exc_type=Exception)

from shmgen.bridge.backend import Node, ServiceWire, Wire
from shmgen.bridge.dds import backend
from shmgen.config import Config
from shmgen.generator import pipeline
from shmgen.live.classes import subscriber
from shmgen.runtime import ServiceClient, ShmError

from ..dds.conftest import Errors
from ..support.dds import LOOPBACK
from ..support.ros1 import wait_for
from ..support.ros2 import Graph
from .test_bridge import SET_BOOL, plc_server, session, set_bool, topic

OTHERS = {
    "type": "float32 x\nfloat64 y\nfloat64 z\n",
    "signed": "int64 x\nint64 y\nint64 z\n",
    "renamed": "float64 x\nfloat64 y\nfloat64 w\n",
    "moved": "float64 y\nfloat64 x\nfloat64 z\n",
    "added": "float64 x\nfloat64 y\nfloat64 z\nuint8 quality\n",
    "removed": "float64 x\nfloat64 y\n",
    "array": "float64[3] xyz\n",
    "sequence": "float64[] xyz\n",
    "bounded": "float64[<=3] xyz\n",
    "nested": "Point at\n",
}
"""Other definitions of geometry_msgs/Vector3: one for each kind of change that the drift check detects."""
ACCEPT_KEYS = {"accepted": 'other_definition = "accept"\n'}

rclpy_only = pytest.mark.parametrize("graph", [("jazzy", "ros2"), ("kilted", "ros2")], indirect=True, ids="-".join)


@pytest.fixture
def dds_peer(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> Iterator[backend.Graph]:
    """A peer with its own definitions, which uses ROS 2's names in DDS and announces its type hashes."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    graph_of_peer = backend.connect(Node("stranger", graph.number, print, lambda: False))
    yield graph_of_peer
    graph_of_peer.close()


def wire(folder: Path, name: str, text: str) -> Wire:
    """Return the topic's wire for a peer with the given definition."""
    for file, content in (("Vector3", text), ("Point", "float64 x\nfloat64 y\nfloat64 z\n")):
        path = folder / "geometry_msgs" / "msg" / f"{file}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    schema = pipeline.read(Config(Path.cwd(), path=(folder,)), ["geometry_msgs/Vector3"])
    return Wire(name, tuple(schema.messages))


@rclpy_only
def test_another_definition_is_refused(graph: Graph, dds_peer: backend.Graph, space: str, tmp_path: Path) -> None:
    names = ["same", "accepted", *OTHERS]
    bridge = graph.bridge(
        f'source = "{graph.source}"\n[bridge]\ndiagnostics = 0.3\n'
        + "".join(topic(f"{space}/{name}", "geometry_msgs/Vector3") + ACCEPT_KEYS.get(name, "") for name in names)
    )
    kind = session(graph).classes(["geometry_msgs/Vector3"])["geometry_msgs/msg/Vector3"]
    peer = graph.peer()
    peer.ask(do="subscribe", topic="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")
    definitions = {"same": "float64 x\nfloat64 y\nfloat64 z\n", "accepted": OTHERS["renamed"], **OTHERS}
    outlets = {name: dds_peer.publisher(wire(tmp_path / name, f"{space}/{name}", definitions[name])) for name in names}
    with ExitStack() as stack:
        readers = {name: stack.enter_context(subscriber(kind, f"{space}/{name}", 1)) for name in names}

        received: set[str] = set()

        def all_are_known() -> bool:
            for outlet in outlets.values():
                outlet.send(outlet.new())
            time.sleep(0.1)
            received.update(name for name in ("same", "accepted") if readers[name].read() is not None)
            return len(received) == 2 and all(
                any(f"{space}/{name}: a peer uses another" in line for line in list(bridge.lines)) for name in OTHERS
            )

        wait_for(all_are_known, "a refusal of each", lambda: "".join(bridge.lines))
        assert [name for name in OTHERS if readers[name].read() is not None] == []
        levels: dict[str, int] = {}

        def all_are_warned() -> bool:
            all_are_known()
            for array in peer.ask(do="take", topic="/diagnostics", count=1):
                for status in array["status"]:
                    name = status["name"].rpartition("/")[2]
                    levels[name] = max(status["level"], levels.get(name, 0))
            return all(levels.get(name) for name in OTHERS)

        wait_for(all_are_warned, "a warning of each", lambda: str(levels))
    assert levels["same"] == levels["accepted"] == 0
    bridge.stop(signal.SIGTERM)
    for name in OTHERS:  # Fast DDS drops messages that are too long for its queue
        bridge.wait_for_line(rf"{space}/{name} +0 passed{', [0-9]+ refused' if name != 'added' else ''}$")
        lines = [line for line in bridge.lines if f"{space}/{name}: a peer" in line]  # Fast DDS also writes to this log
        assert len(lines) == 1
        assert lines[0].count("RIHS01_") == 2
    for name in ("same", "accepted"):
        bridge.wait_for_line(rf"{space}/{name} +\d+ passed$")
    assert len([line for line in bridge.lines if f"{space}/accepted: a peer uses another" in line]) == 1


@pytest.mark.parametrize("graph", [("jazzy", "dds"), ("kilted", "dds")], indirect=True, ids="-".join)
@pytest.mark.parametrize("last", ["float64 z\nfloat64 more\n", "int64 z\n"], ids=["longer", "another"])
def test_every_message_of_another_definition_is_counted(graph: Graph, space: str, last: str) -> None:
    """Count also messages that Cyclone itself drops as too short. Diagnostics warn while the sender exists."""
    file = graph.folder / "msgs" / "geometry_msgs" / "msg" / "Vector3.msg"
    file.parent.mkdir(parents=True)
    file.write_text(f"float64 x\nfloat64 y\n{last}")
    bridge = graph.bridge(
        f'source = "{graph.source}"\npath = ["msgs"]\n[bridge]\ndiagnostics = 0.3\n'
        + topic(f"{space}/v", "geometry_msgs/Vector3")
    )
    peer = graph.peer()
    peer.ask(do="subscribe", topic="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")

    def is_level(level: int) -> bool:
        arrays = peer.ask(do="take", topic="/diagnostics", count=1)
        return [status["level"] for array in arrays for status in array["status"]][-1:] == [level]

    wait_for(lambda: is_level(0), "a level of OK")
    peer.ask(do="advertise", topic=f"{space}/v", type="geometry_msgs/msg/Vector3")
    assert peer.ask(do="connected", topic=f"{space}/v")
    bridge.wait_for_line(f"{space}/v: a peer uses another")  # Cyclone drops samples that arrive before it has matched
    peer.ask(do="publish", topic=f"{space}/v", messages=[{"x": 1.0}] * 50, period=0.002)
    bridge.counted(f"{space}/v +0 passed, 50 refused")
    peer.ask(do="take", topic="/diagnostics", count=1000, timeout=2)
    assert is_level(1)
    peer.ask(do="withdraw", topic=f"{space}/v")
    wait_for(lambda: is_level(0), "a level of OK")


@rclpy_only
def test_subscriber_of_another_definition_is_reported(
    graph: Graph, dds_peer: backend.Graph, space: str, tmp_path: Path
) -> None:
    """Report it because it misreads the bridge's messages, whether it joins before or after the bridge."""
    texts = {"same": "float64 x\nfloat64 y\nfloat64 z\n", "first": "float64 a\n", "last": "float64 a\n"}
    dds_peer.subscribe(wire(tmp_path / "first", f"{space}/first", texts["first"]), lambda message: None, Errors())
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + "".join(topic(f"{space}/{name}", "geometry_msgs/Vector3", 'direction = "from_plc"') for name in texts)
    )
    for name in ("same", "last"):
        dds_peer.subscribe(wire(tmp_path / name, f"{space}/{name}", texts[name]), lambda message: None, Errors())
    for name in ("first", "last"):
        bridge.wait_for_line(f"{space}/{name}: a peer uses another definition.*it will misread the bridge's messages")
    bridge.stop(signal.SIGTERM)
    assert not [line for line in bridge.lines if f"{space}/same: " in line]


def service(folder: Path, name: str, request: str) -> ServiceWire:
    """Return the wire of std_srvs/SetBool for a peer with the given request definition."""
    file = folder / "std_srvs" / "srv" / "SetBool.srv"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"{request}\n---\nbool success\nstring message\n")
    parts = {
        msg.name.name: msg for msg in pipeline.read(Config(Path.cwd(), path=(folder,)), ["std_srvs/SetBool"]).messages
    }
    return ServiceWire(name, (parts["SetBool_Request"],), (parts["SetBool_Response"],))


@rclpy_only
def test_other_service_type_is_refused(graph: Graph, dds_peer: backend.Graph, space: str, tmp_path: Path) -> None:
    """Pass no calls while a client and a server of another definition exist, not even calls of matching peers."""
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + SET_BOOL.format(space=space, server="plc", timeout=1)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=3)
    )
    peer = graph.peer()
    command = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {}, "timeout": 2}
    peer.ask(do="serve", service=f"{space}/of/flag", type="std_srvs/srv/SetBool", answers=[])
    set_bool_client = set_bool(graph, ServiceClient)
    requests: list[Any] = []

    def handler(request: Any) -> Any:
        requests.append(request)
        return SimpleNamespace(success=True, message="")

    with plc_server(graph, f"{space}/flag", handler), set_bool_client(f"{space}/of/flag") as plc:
        assert peer.ask(**command | {"timeout": 20}) == {"success": True, "message": ""}  # includes discovery
        assert plc.call(SimpleNamespace(data=True), 5) is not None
        requests.clear()
        dds_peer.client(service(tmp_path, f"{space}/flag", "int8 data"))
        dds_peer.serve(service(tmp_path, f"{space}/of/flag", "int8 data"), lambda *call: None, Errors())

        def is_refused(name: str) -> bool:
            """Return True if the log reports the refusal: on a busy machine, a call may fail for another reason."""
            return any(
                line.startswith(f"{space}/{name}: ") and "no messages pass" in line for line in list(bridge.lines)
            )

        def both_are_refused() -> bool:
            peer.ask(**command)
            with suppress(ShmError):
                plc.call(SimpleNamespace(data=True), 3)
            return is_refused("flag") and is_refused("of/flag")

        wait_for(both_are_refused, "a refusal of each", lambda: "".join(bridge.lines))
        requests.clear()
        assert peer.ask(**command) == "no answer"
        with pytest.raises(ShmError):
            plc.call(SimpleNamespace(data=True), 3)
        assert requests == []
    bridge.stop(signal.SIGTERM)
    for name in ("flag", "of/flag"):
        (text,) = [line for line in bridge.lines if line.startswith(f"{space}/{name}: ") and "no messages pass" in line]
        assert text.count("RIHS01_") == 2
    bridge.wait_for_line(rf"{space}/flag +\d+ passed, \d+ refused$")
    bridge.wait_for_line(rf"{space}/of/flag +\d+ passed, \d+ failed$")


@pytest.mark.parametrize("graph", [("jazzy", "dds"), ("kilted", "dds")], indirect=True, ids="-".join)
def test_dds_refuses_other_types(graph: Graph, space: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse messages of rclpy over Cyclone, which knows only the names of rclpy's types."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    log: list[str] = []
    outlets: list[Any] = []  # keeps the publishers alive
    bridge_graph = backend.connect(Node("ours", graph.number, log.append, lambda: False))
    definitions = {"same": "float64 x\nfloat64 y\nfloat64 z\n", "accepted": OTHERS["renamed"], **OTHERS}
    received: dict[str, list[Any]] = {name: [] for name in definitions}
    errors = {name: Errors() for name in definitions}
    peer = graph.peer()
    try:
        for name, text in definitions.items():
            own_wire = replace(wire(tmp_path / name, f"{space}/{name}", text), accepts_other=name in ACCEPT_KEYS)
            bridge_graph.subscribe(own_wire, received[name].append, errors[name])
            peer.ask(do="advertise", topic=f"{space}/{name}", type="geometry_msgs/msg/Vector3")
            outlets.append(bridge_graph.publisher(wire(tmp_path / name, f"{space}/back_{name}", text)))
            peer.ask(do="subscribe", topic=f"{space}/back_{name}", type="geometry_msgs/msg/Vector3")
        for name in definitions:
            assert peer.ask(do="connected", topic=f"{space}/{name}") == 1, name
            peer.ask(do="publish", topic=f"{space}/{name}", messages=[{"x": 1.5}] * 2)
        wait_for(lambda: len(received["same"]) == len(received["accepted"]) == 2, "what is the same")
        wait_for(lambda: all(errors[name].logged for name in OTHERS), "refusals", lambda: str(log))
        wait_for(lambda: len(log) >= 2 * len(OTHERS) + 2, "a word on subscribers", lambda: str(log))
    finally:
        bridge_graph.close()
    assert [name for name in definitions if received[name]] == ["same", "accepted"]
    others = [name for name in definitions if name != "same"]
    expected = sorted(f"{space}/{back}{name}" for name in others for back in ("", "back_"))
    assert sorted(line.partition(":")[0] for line in log) == expected
    assert all(line.count("RIHS01_") == 2 for line in log)
