"""What a peer of another definition sends never becomes a value in the PLC, whichever way it is another."""

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
from shmgen.live.classes import client, subscriber
from shmgen.runtime import ShmError

from ..dds.conftest import Taken
from ..support.dds import LOOPBACK
from ..support.ros1 import wait_for
from ..support.ros2 import Graph
from .test_bridge import SET_BOOL, plc_server, session, topic

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
"""What others may mean by geometry_msgs/Vector3: a change of each kind that drift knows."""
ACCEPTS = {"accepted": 'other_definition = "accept"\n'}

WAYS = pytest.mark.parametrize("graph", [("jazzy", "ros2"), ("kilted", "ros2")], indirect=True, ids="-".join)


@pytest.fixture
def stranger(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> Iterator[backend.Graph]:
    """A peer whose definitions are its own: it has ROS 2's names on the wire, and announces their type hashes."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    made = backend.connect(Node("stranger", graph.number, print, lambda: False))
    yield made
    made.close()


def wire(folder: Path, name: str, text: str) -> Wire:
    """The topic as somebody with that definition sees it."""
    for file, content in (("Vector3", text), ("Point", "float64 x\nfloat64 y\nfloat64 z\n")):
        path = folder / "geometry_msgs" / "msg" / f"{file}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    schema = pipeline.read(Config(Path.cwd(), path=(folder,)), ["geometry_msgs/Vector3"])
    return Wire(name, tuple(schema.messages))


@WAYS
def test_another_definition_is_no_value(graph: Graph, stranger: backend.Graph, space: str, tmp_path: Path) -> None:
    names = ["same", "accepted", *OTHERS]
    bridge = graph.bridge(
        f'source = "{graph.source}"\n[bridge]\ndiagnostics = 0.3\n'
        + "".join(topic(f"{space}/{name}", "geometry_msgs/Vector3") + ACCEPTS.get(name, "") for name in names)
    )
    kind = session(graph).classes(["geometry_msgs/Vector3"])["geometry_msgs/msg/Vector3"]
    peer = graph.peer()
    peer.ask(do="subscribe", topic="/diagnostics", type="diagnostic_msgs/msg/DiagnosticArray")
    definitions = {"same": "float64 x\nfloat64 y\nfloat64 z\n", "accepted": OTHERS["renamed"], **OTHERS}
    outlets = {name: stranger.publisher(wire(tmp_path / name, f"{space}/{name}", definitions[name])) for name in names}
    with ExitStack() as stack:
        readers = {name: stack.enter_context(subscriber(kind, f"{space}/{name}", 1)) for name in names}

        came: set[str] = set()

        def sent() -> bool:
            for outlet in outlets.values():
                outlet.send(outlet.new())
            time.sleep(0.1)
            came.update(name for name in ("same", "accepted") if readers[name].read() is not None)
            return len(came) == 2 and all(
                any(f"{space}/{name}: a peer has another" in line for line in list(bridge.lines)) for name in OTHERS
            )

        wait_for(sent, "a refusal of each", lambda: "".join(bridge.lines))
        assert [name for name in OTHERS if readers[name].read() is not None] == []
        levels: dict[str, int] = {}

        def warned() -> bool:
            sent()
            for array in peer.ask(do="take", topic="/diagnostics", count=1):
                for status in array["status"]:
                    name = status["name"].rpartition("/")[2]
                    levels[name] = max(status["level"], levels.get(name, 0))
            return all(levels.get(name) for name in OTHERS)

        wait_for(warned, "a warning of each", lambda: str(levels))
    assert levels["same"] == levels["accepted"] == 0
    bridge.stop(signal.SIGTERM)
    for name in OTHERS:  # what is too long for a queue of Fast DDS does not come at all
        bridge.wait_for_line(rf"{space}/{name} +0 passed{', [0-9]+ refused' if name != 'added' else ''}$")
        told = [line for line in bridge.lines if f"{space}/{name}: a peer" in line]  # Fast DDS writes there too
        assert len(told) == 1
        assert told[0].count("RIHS01_") == 2
    for name in ("same", "accepted"):
        bridge.wait_for_line(rf"{space}/{name} +\d+ passed$")
    assert len([line for line in bridge.lines if f"{space}/accepted: a peer has another" in line]) == 1


@pytest.mark.parametrize("graph", [("jazzy", "dds"), ("kilted", "dds")], indirect=True, ids="-".join)
@pytest.mark.parametrize("last", ["float64 z\nfloat64 more\n", "int64 z\n"], ids=["longer", "another"])
def test_each_message_of_another_definition_is_counted(graph: Graph, space: str, last: str) -> None:
    """Also those that Cyclone drops itself, being too short; and diagnostics warn for as long as their sender is."""
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
    bridge.wait_for_line(f"{space}/v: a peer has another")  # Cyclone drops samples that arrive before it has matched
    peer.ask(do="publish", topic=f"{space}/v", messages=[{"x": 1.0}] * 50, period=0.002)
    bridge.counted(f"{space}/v +0 passed, 50 refused")
    peer.ask(do="take", topic="/diagnostics", count=1000, timeout=2)
    assert is_level(1)
    peer.ask(do="withdraw", topic=f"{space}/v")
    wait_for(lambda: is_level(0), "a level of OK")


@WAYS
def test_a_subscriber_of_another_definition_is_told_of(
    graph: Graph, stranger: backend.Graph, space: str, tmp_path: Path
) -> None:
    """What it makes of our bytes is its own matter, but somebody should know; it may come first or last."""
    texts = {"same": "float64 x\nfloat64 y\nfloat64 z\n", "first": "float64 a\n", "last": "float64 a\n"}
    takers = {name: Taken(lambda message: None) for name in texts}
    stranger.subscribe(wire(tmp_path / "first", f"{space}/first", texts["first"]), takers["first"])
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + "".join(topic(f"{space}/{name}", "geometry_msgs/Vector3", 'direction = "from_plc"') for name in texts)
    )
    for name in ("same", "last"):
        stranger.subscribe(wire(tmp_path / name, f"{space}/{name}", texts[name]), takers[name])
    for name in ("first", "last"):
        bridge.wait_for_line(
            f"{space}/{name}: a peer has another geometry_msgs/Vector3: .*it will misread the bridge's messages"
        )
    bridge.stop(signal.SIGTERM)
    assert not [line for line in bridge.lines if f"{space}/same: " in line]


def service(folder: Path, name: str, request: str) -> ServiceWire:
    """std_srvs/SetBool as somebody with that request sees it."""
    file = folder / "std_srvs" / "srv" / "SetBool.srv"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"{request}\n---\nbool success\nstring message\n")
    parts = {
        one.name.name: one for one in pipeline.read(Config(Path.cwd(), path=(folder,)), ["std_srvs/SetBool"]).messages
    }
    return ServiceWire(name, (parts["SetBool_Request"],), (parts["SetBool_Response"],))


@WAYS
def test_a_service_of_another_definition(graph: Graph, stranger: backend.Graph, space: str, tmp_path: Path) -> None:
    """While such a client or server is there, real rclpy hears nothing through rclpy, and the PLC is not asked."""
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + SET_BOOL.format(space=space, server="plc", timeout=1)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=3)
    )
    peer = graph.peer()
    asked = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {}, "timeout": 2}
    peer.ask(do="serve", service=f"{space}/of/flag", type="std_srvs/srv/SetBool", answers=[])
    kinds = session(graph).classes(["std_srvs/SetBool"])
    calling = client(kinds["std_srvs/srv/SetBool_Request"], kinds["std_srvs/srv/SetBool_Reply"])
    served: list[Any] = []

    def handler(request: Any) -> Any:
        served.append(request)
        return SimpleNamespace(success=True, message="")

    with plc_server(graph, f"{space}/flag", handler), calling(f"{space}/of/flag") as plc:
        assert peer.ask(**asked | {"timeout": 20}) == {"success": True, "message": ""}  # they have to find each other
        assert plc.call(SimpleNamespace(data=True), 5) is not None
        served.clear()
        stranger.client(service(tmp_path, f"{space}/flag", "int8 data"))
        stranger.serve(service(tmp_path, f"{space}/of/flag", "int8 data"), lambda *call: None, print)

        def refused(name: str) -> bool:
            """A call that failed may have failed for another reason, on a busy machine."""
            return any(
                line.startswith(f"{space}/{name}: ") and "no messages pass" in line for line in list(bridge.lines)
            )

        def called() -> bool:
            peer.ask(**asked)
            with suppress(ShmError):
                plc.call(SimpleNamespace(data=True), 3)
            return refused("flag") and refused("of/flag")

        wait_for(called, "a refusal of each", lambda: "".join(bridge.lines))
        served.clear()
        assert peer.ask(**asked) == "no answer"
        with pytest.raises(ShmError):
            plc.call(SimpleNamespace(data=True), 3)
        assert served == []
    bridge.stop(signal.SIGTERM)
    for name in ("flag", "of/flag"):
        (told,) = [line for line in bridge.lines if line.startswith(f"{space}/{name}: ") and "no messages pass" in line]
        assert told.count("RIHS01_") == 2
    bridge.wait_for_line(rf"{space}/flag +\d+ passed, \d+ refused$")
    bridge.wait_for_line(rf"{space}/of/flag +\d+ passed, \d+ failed$")


@pytest.mark.parametrize("graph", [("jazzy", "dds"), ("kilted", "dds")], indirect=True, ids="-".join)
def test_where_ours_is_another(graph: Graph, space: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Through Cyclone, from real rclpy: of its types Cyclone knows nothing but what they are called."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    told: list[str] = []
    outlets: list[Any] = []  # or they are gone at once
    ours = backend.connect(Node("ours", graph.number, told.append, lambda: False))
    definitions = {"same": "float64 x\nfloat64 y\nfloat64 z\n", "accepted": OTHERS["renamed"], **OTHERS}
    came: dict[str, list[Any]] = {name: [] for name in definitions}
    takers = {name: Taken(came[name].append) for name in definitions}
    peer = graph.peer()
    try:
        for name, text in definitions.items():
            there = replace(wire(tmp_path / name, f"{space}/{name}", text), accepts_other=name in ACCEPTS)
            ours.subscribe(there, takers[name])
            peer.ask(do="advertise", topic=f"{space}/{name}", type="geometry_msgs/msg/Vector3")
            outlets.append(ours.publisher(wire(tmp_path / name, f"{space}/back_{name}", text)))
            peer.ask(do="subscribe", topic=f"{space}/back_{name}", type="geometry_msgs/msg/Vector3")
        for name in definitions:
            assert peer.ask(do="connected", topic=f"{space}/{name}") == 1, name
            peer.ask(do="publish", topic=f"{space}/{name}", messages=[{"x": 1.5}] * 2)
        wait_for(lambda: len(came["same"]) == len(came["accepted"]) == 2, "what is the same")
        wait_for(lambda: all(takers[name].logged for name in OTHERS), "refusals", lambda: str(told))
        wait_for(lambda: len(told) >= 2 * len(OTHERS) + 2, "a word on subscribers", lambda: str(told))
    finally:
        ours.close()
    assert [name for name in definitions if came[name]] == ["same", "accepted"]
    others = [name for name in definitions if name != "same"]
    both = sorted(f"{space}/{back}{name}" for name in others for back in ("", "back_"))
    assert sorted(line.partition(":")[0] for line in told) == both
    assert all(line.count("RIHS01_") == 2 for line in told)
