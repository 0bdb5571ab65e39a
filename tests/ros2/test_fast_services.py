"""Services of real rclpy on rmw_fastrtps through the bridge's part of Fast DDS: who is answered, and how it is made."""

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
from shmgen.live.classes import client, server
from shmgen.runtime import ShmError

from ..conftest import REPOSITORY
from ..support.dds import this_machine, without_fast_dds
from ..support.ros1 import Bridge, wait_for
from ..support.ros2 import Graph
from ..support.schemas import plain, random_message
from .test_bridge import SET_BOOL, call, monkeypatched, plc_server, session
from .test_identity import service

by_dds = pytest.mark.parametrize("graph", [("jazzy", "dds"), ("kilted", "dds")], indirect=True, ids="-".join)

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


@by_dds
def test_each_value_and_each_client(graph: Graph, space: str) -> None:
    """All types of a field both ways, and several clients at once, of which each gets its own answers."""
    bridge = graph.bridge(ALL_TYPES.format(space=space))
    with monkeypatched(graph):
        made = session(graph)
        kinds = made.classes(["test_msgs/srv/BasicTypes"])
        layouts = made.layouts(["test_msgs/srv/BasicTypes"])
    request, reply = kinds[f"{BASIC}_Request"], kinds[f"{BASIC}_Reply"]
    layout = next(one for one in layouts.values() if str(one.name) == f"{BASIC}_Request")
    sent = [plain(random_message(layout, layouts, random.Random(seed))) for seed in range(12)]
    peers = [graph.peer() for _ in range(3)]
    peers[0].ask(do="serve", service=f"{space}/ros", type=BASIC, answers=list(sent))
    ended = threading.Event()

    def serve() -> None:
        with server(request, reply)(f"{space}/plc") as served:
            while not ended.is_set():
                served.serve(lambda request: request, timeout=0.05)

    answers: dict[int, list[Any]] = {}

    def ask(number: int) -> None:
        asked = {"do": "call", "service": f"{space}/plc", "type": BASIC, "timeout": 20}
        answers[number] = [peers[number].ask(**asked, request=values) for values in sent[number::3]]

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(3)]
    plc = threading.Thread(target=serve)
    plc.start()
    try:
        too_long = {
            "do": "call",
            "service": f"{space}/plc",
            "type": BASIC,
            "request": {"string_value": "x" * 24_000_000},
        }
        memory = most_memory(bridge)
        wait_for(lambda: peers[0].ask(**too_long, timeout=1) == "no answer", "a server")
        assert most_memory(bridge) - memory < 12_000  # so it has not come in
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert [answers[number] for number in range(3)] == [sent[number::3] for number in range(3)]
        with client(request, reply)(f"{space}/ros") as calling:
            assert [plain(calling.call(SimpleNamespace(**values), 20)) for values in sent] == sent
    finally:
        ended.set()
        plc.join()
    bridge.stop(signal.SIGTERM)
    for name in ("plc", "ros"):
        bridge.wait_for_line(f"{space}/{name} +12 passed$")


def most_memory(bridge: Bridge) -> int:
    """KiB that the process has ever had."""
    status = Path(f"/proc/{bridge.process.pid}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0])


@by_dds
def test_clients_of_both_kinds(graph: Graph, space: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of Cyclone and one of Fast DDS, at the same service: each call is answered once, to whose it is."""
    graph.number = 1 + (graph.number + 24) % 100  # Cyclone sets a domain up once in a process
    bridge = graph.bridge(f'source = "{graph.source}"\n' + SET_BOOL.format(space=space, server="plc", timeout=20))
    monkeypatch.setenv("CYCLONEDDS_URI", this_machine())
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    served: list[bool] = []

    def handler(request: Any) -> Any:
        served.append(request.data)
        return SimpleNamespace(success=not request.data, message=f"of the PLC {request.data}")

    peer = graph.peer()
    asked = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {}, "timeout": 20}
    of_fast: list[Any] = []
    cyclone = backend.connect(Node("cyclone", graph.number, print, lambda: False))
    try:
        caller = cyclone.client(service(tmp_path, f"{space}/flag", "bool data"))
        request = caller.new()
        request.data = True
        with plc_server(graph, f"{space}/flag", handler):
            of_fast.append(peer.ask(**asked))
            caller.call(request, 20)  # both are there
            calls = threading.Thread(target=lambda: of_fast.extend(peer.ask(**asked) for _ in range(20)))
            calls.start()
            of_cyclone = [caller.call(request, 20) for _ in range(20)]
            calls.join()
    finally:
        cyclone.close()
    assert of_fast == [{"success": True, "message": "of the PLC False"}] * 21
    assert {(one.success, one.message) for one in of_cyclone} == {(False, "of the PLC True")}
    assert (served.count(True), served.count(False)) == (21, 21)
    bridge.stop(signal.SIGTERM)
    bridge.wait_for_line(f"{space}/flag +42 passed$")


@by_dds
def test_where_ours_is_another(graph: Graph, space: str) -> None:
    """Both ways, real rclpy and a PLC do not mean the same by SetBool: no call reaches either."""
    file = graph.folder / "msgs" / "std_srvs" / "srv" / "SetBool.srv"
    file.parent.mkdir(parents=True)
    file.write_text("int8 data\n---\nbool success\nstring message\n")
    bridge = graph.bridge(
        'path = ["msgs"]\n'
        + SET_BOOL.format(space=space, server="plc", timeout=1)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=3)
    )
    kinds = session(graph).classes(["std_srvs/SetBool"])
    calling = client(kinds["std_srvs/srv/SetBool_Request"], kinds["std_srvs/srv/SetBool_Reply"])
    peer, kind = graph.peer(), "std_srvs/srv/SetBool"
    peer.ask(do="serve", service=f"{space}/of/flag", type=kind, answers=[])
    with (
        plc_server(graph, f"{space}/flag", lambda request: SimpleNamespace(success=True, message="")),
        calling(f"{space}/of/flag") as plc,
    ):
        asked = {"do": "call", "service": f"{space}/flag", "type": kind, "request": {}, "timeout": 2}
        wait_for(lambda: peer.ask(**asked) == "no answer", "a server")
        with pytest.raises(ShmError):
            plc.call(SimpleNamespace(data=1), 20)
    bridge.stop(signal.SIGTERM)
    for name in ("flag", "of/flag"):
        bridge.wait_for_line(f"{space}/{name}: a peer has another std_srvs/SetBool_Request: .*no messages pass")
    bridge.wait_for_line(rf"{space}/flag +0 passed, \d+ refused$")
    bridge.wait_for_line(f"{space}/of/flag +0 passed, 1 failed$")


@by_dds
def test_without_it(graph: Graph, space: str) -> None:
    """Through Cyclone nobody on rmw_fastrtps can be answered or asked: said once, as soon as the two meet."""
    (graph.folder / "shmgen_fastdds.py").write_text("raise ImportError")
    bridge = graph.bridge(
        f'source = "{graph.source}"\n'
        + SET_BOOL.format(space=space, server="plc", timeout=1)
        + SET_BOOL.format(space=f"{space}/of", server="ros", timeout=1)
    )
    peer = graph.peer()
    asked = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {}, "timeout": 1}
    peer.ask(do="serve", service=f"{space}/of/flag", type="std_srvs/srv/SetBool", answers=[])
    kinds = session(graph).classes(["std_srvs/SetBool"])
    calling = client(kinds["std_srvs/srv/SetBool_Request"], kinds["std_srvs/srv/SetBool_Reply"])
    with (
        plc_server(graph, f"{space}/flag", lambda request: SimpleNamespace(success=True, message="")),
        calling(f"{space}/of/flag") as plc,
    ):
        assert {peer.ask(**asked) for _ in range(2)} <= {"no answer", "no server"}
        for _ in range(2):
            assert "failed" in call(plc)
    for name in ("flag", "of/flag"):
        bridge.wait_for_line(
            f"^{space}/{name}: a peer is not on rmw_cyclonedds.*install shmgen-fastdds .*--backend ros2"
        )
    bridge.stop(signal.SIGTERM)
    assert len([line for line in bridge.lines if "--backend ros2" in line]) == 2
    bridge.wait_for_line(f"{space}/flag +0 passed, 1 refused$")
    bridge.wait_for_line(f"{space}/of/flag +0 passed, 2 failed$")


@pytest.mark.parametrize("graph", [("jazzy", "dds")], indirect=True, ids="-".join)
def test_installed_from_its_sdist(graph: Graph, space: str) -> None:
    """By pip, beside shmgen."""
    hatchling = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", graph.folder]
    subprocess.run(hatchling, cwd=REPOSITORY / "packaging" / "shmgen-fastdds", check=True, stdout=-3)
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    (sdist,) = graph.folder.glob("shmgen_fastdds-*.tar.gz")
    subprocess.run([*pip, "--target", graph.folder, sdist], check=True, stderr=-3)
    bridge = graph.bridge(f'source = "{graph.source}"\n' + SET_BOOL.format(space=space, server="plc", timeout=20))
    maps = Path(f"/proc/{bridge.process.pid}/maps").read_text()
    assert f"{graph.folder}/shmgen_fastdds/services.so" in maps
    asked = {"do": "call", "service": f"{space}/flag", "type": "std_srvs/srv/SetBool", "request": {}, "timeout": 20}
    with plc_server(graph, f"{space}/flag", lambda request: SimpleNamespace(success=True, message="of the PLC")):
        assert graph.peer().ask(**asked) == {"success": True, "message": "of the PLC"}
    bridge.stop(signal.SIGTERM)
