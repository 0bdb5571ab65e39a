"""Test services of rclpy on rmw_fastrtps through shmgen-fastdds, and the installation of shmgen-fastdds."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("cyclonedds", exc_type=Exception)

from shmgen.bridge.backend import Node
from shmgen.bridge.dds import backend
from shmgen.live.classes import call_class
from shmgen.runtime import ServiceClient, ServiceServer, ShmError

from ..conftest import REPOSITORY
from ..support.dds import this_machine, without_fast_dds
from ..support.ros1 import Bridge, wait_for
from ..support.ros2 import Graph
from ..support.schemas import plain, random_message
from .test_bridge import SET_BOOL, call, plc_server, ros_environment, session, set_bool
from .test_identity import service

dds_only = pytest.mark.parametrize("graph", [("jazzy", "dds"), ("kilted", "dds")], indirect=True, ids="-".join)

BASIC = "test_msgs/srv/BasicTypes"
ALL_TYPES = """
source = "env"
[strings]
default = 40
[[services]]
service = "{space}/plc"
type = "test_msgs/srv/BasicTypes"
timeout = 20
[[services]]
service = "{space}/ros"
type = "test_msgs/srv/BasicTypes"
server = "ros"
timeout = 20
"""


@pytest.fixture(autouse=True)
def _fast_dds() -> None:
    without_fast_dds()


@dds_only
def test_every_field_type_passes_with_concurrent_clients(graph: Graph, space: str) -> None:
    """Pass all field types both ways. Each of several concurrent clients receives its own replies."""
    bridge = graph.bridge(ALL_TYPES.format(space=space))
    with ros_environment(graph):
        schema_session = session(graph)
        kinds = schema_session.classes(["test_msgs/srv/BasicTypes"])
        layouts = schema_session.layouts(["test_msgs/srv/BasicTypes"])
    parts = {end: kinds[f"{BASIC}{end}"] for end in ("_Request", "_Reply")}
    layout = next(layout_ for layout_ in layouts.values() if str(layout_.name) == f"{BASIC}_Request")
    sent = [plain(random_message(layout, layouts, random.Random(seed))) for seed in range(12)]
    peers = [graph.peer() for _ in range(3)]
    peers[0].ask(do="serve", service=f"{space}/ros", type=BASIC, answers=list(sent))
    stop = threading.Event()

    def serve() -> None:
        with call_class(ServiceServer, parts)(f"{space}/plc") as served:
            while not stop.is_set():
                served.serve(lambda request: request, timeout=0.05)

    answers: dict[int, list[Any]] = {}

    def send_calls(number: int) -> None:
        command = {"do": "call", "service": f"{space}/plc", "type": BASIC, "timeout": 20}
        answers[number] = [peers[number].ask(**command, request=values) for values in sent[number::3]]

    threads = [threading.Thread(target=send_calls, args=(number,)) for number in range(3)]
    plc = threading.Thread(target=serve)
    plc.start()
    try:
        too_long = {
            "do": "call",
            "service": f"{space}/plc",
            "type": BASIC,
            "request": {"string_value": "x" * 24_000_000},
        }
        memory = peak_memory(bridge)
        wait_for(lambda: peers[0].ask(**too_long, timeout=1) == "no answer", "a server")
        assert peak_memory(bridge) - memory < 12_000  # the bridge has not received the request
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert [answers[number] for number in range(3)] == [sent[number::3] for number in range(3)]
        with call_class(ServiceClient, parts)(f"{space}/ros") as set_bool_client:
            assert [plain(set_bool_client.call(SimpleNamespace(**values), 20)) for values in sent] == sent
    finally:
        stop.set()
        plc.join()
    bridge.stop(signal.SIGTERM)
    for name in ("plc", "ros"):
        bridge.wait_for_line(f"{space}/{name} +12 passed$")


def peak_memory(bridge: Bridge) -> int:
    """Return the peak memory of the process in KiB."""
    status = Path(f"/proc/{bridge.process.pid}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0])


@dds_only
def test_clients_of_both_dds_succeed(graph: Graph, space: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Answer each call once and to its client, while a Cyclone and a Fast DDS client call the same service."""
    graph.number = 1 + (graph.number + 24) % 100  # a process can configure a Cyclone domain only once
    bridge = graph.bridge(f'source = "{graph.source}"\n' + SET_BOOL.format(space=space, server="plc", timeout=20))
    monkeypatch.setenv("CYCLONEDDS_URI", this_machine())
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    values: list[bool] = []

    def handler(request: Any) -> Any:
        values.append(request.data)
        return SimpleNamespace(success=not request.data, message=f"of the PLC {request.data}")

    peer = graph.peer()
    command = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {}, "timeout": 20}
    fast_replies: list[Any] = []
    cyclone = backend.connect(Node("cyclone", graph.number, print, lambda: False))
    try:
        caller = cyclone.client(service(tmp_path, f"{space}/flag", "bool data"))
        request = caller.new()
        request.data = True
        with plc_server(graph, f"{space}/flag", handler):
            fast_replies.append(peer.ask(**command))
            caller.call(request, 20)  # now both clients are discovered
            calls = threading.Thread(target=lambda: fast_replies.extend(peer.ask(**command) for _ in range(20)))
            calls.start()
            cyclone_replies = [caller.call(request, 20) for _ in range(20)]
            calls.join()
    finally:
        cyclone.close()
    assert fast_replies == [{"success": True, "message": "of the PLC False"}] * 21
    assert {(reply.success, reply.message) for reply in cyclone_replies} == {(False, "of the PLC True")}
    assert (values.count(True), values.count(False)) == (21, 21)
    bridge.stop(signal.SIGTERM)
    bridge.wait_for_line(f"{space}/flag +42 passed$")


@dds_only
def test_service_of_another_definition_receives_no_call(graph: Graph, space: str) -> None:
    """Pass no call in either direction if rclpy and the PLC have different definitions of SetBool."""
    file = graph.folder / "msgs" / "std_srvs" / "srv" / "SetBool.srv"
    file.parent.mkdir(parents=True)
    file.write_text("int8 data\n---\nbool success\nstring message\n")
    bridge = graph.bridge(
        'path = ["msgs"]\n'
        + SET_BOOL.format(space=space, server="plc", timeout=1)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=3)
    )
    set_bool_client = set_bool(graph, ServiceClient)
    peer, kind = graph.peer(), "std_srvs/srv/SetBool"
    peer.ask(do="serve", service=f"{space}/of/flag", type=kind, answers=[])
    with (
        plc_server(graph, f"{space}/flag", lambda request: SimpleNamespace(success=True, message="")),
        set_bool_client(f"{space}/of/flag") as plc,
    ):
        command = {"do": "call", "service": f"{space}/flag", "type": kind, "request": {}, "timeout": 2}
        wait_for(lambda: peer.ask(**command) == "no answer", "a server")
        with pytest.raises(ShmError):
            plc.call(SimpleNamespace(data=1), 20)
    bridge.stop(signal.SIGTERM)
    for name in ("flag", "of/flag"):
        bridge.wait_for_line(f"{space}/{name}: .*another definition of std_srvs/SetBool_Request.*no messages pass")
    bridge.wait_for_line(rf"{space}/flag +0 passed, \d+ refused$")
    bridge.wait_for_line(f"{space}/of/flag +0 passed, 1 failed$")


@dds_only
def test_missing_shmgen_fastdds_is_reported(graph: Graph, space: str) -> None:
    """Report once for each service that Cyclone cannot exchange calls with a peer on rmw_fastrtps."""
    (graph.folder / "shmgen_fastdds.py").write_text("raise ImportError")
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + SET_BOOL.format(space=space, server="plc", timeout=1)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=1)
    )
    peer = graph.peer()
    command = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {}, "timeout": 1}
    peer.ask(do="serve", service=f"{space}/of/flag", type="std_srvs/srv/SetBool", answers=[])
    set_bool_client = set_bool(graph, ServiceClient)
    with (
        plc_server(graph, f"{space}/flag", lambda request: SimpleNamespace(success=True, message="")),
        set_bool_client(f"{space}/of/flag") as plc,
    ):
        assert {peer.ask(**command) for _ in range(2)} <= {"no answer", "no server"}
        for _ in range(2):
            assert "failed" in call(plc)
    for name in ("flag", "of/flag"):
        bridge.wait_for_line(
            f"^{space}/{name}: a peer does not use rmw_cyclonedds.*install shmgen-fastdds .*--backend ros2"
        )
    bridge.stop(signal.SIGTERM)
    assert len([line for line in bridge.lines if "--backend ros2" in line]) == 2
    bridge.wait_for_line(f"{space}/flag +0 passed, 1 refused$")
    bridge.wait_for_line(f"{space}/of/flag +0 passed, 2 failed$")


@pytest.mark.parametrize("graph", [("jazzy", "dds")], indirect=True, ids="-".join)
def test_pip_installs_the_sdist_of_shmgen_fastdds(graph: Graph, space: str) -> None:
    hatchling = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", graph.folder]
    subprocess.run(hatchling, cwd=REPOSITORY / "packaging" / "shmgen-fastdds", check=True, stdout=-3)
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    (sdist,) = graph.folder.glob("shmgen_fastdds-*.tar.gz")
    subprocess.run([*pip, "--target", graph.folder, sdist], check=True, stderr=-3)
    bridge = graph.bridge(f'source = "{graph.source}"\n' + SET_BOOL.format(space=space, server="plc", timeout=20))
    maps = Path(f"/proc/{bridge.process.pid}/maps").read_text()
    assert f"{graph.folder}/shmgen_fastdds/services.so" in maps
    command = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {}, "timeout": 20}
    with plc_server(graph, f"{space}/flag", lambda request: SimpleNamespace(success=True, message="of the PLC")):
        assert graph.peer().ask(**command) == {"success": True, "message": "of the PLC"}
    bridge.stop(signal.SIGTERM)
