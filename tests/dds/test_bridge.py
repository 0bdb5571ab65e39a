"""Test `shmgen bridge` over DDS between an independent peer and a PLC program, also after each of them restarts."""

from __future__ import annotations

import re
import signal
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from shmgen.bridge.backend import NoAnswer
from shmgen.bridge.dds import backend
from shmgen.bridge.dds.types import topic_name
from shmgen.bridge.plan import services
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline
from shmgen.live.classes import call_class
from shmgen.live.session import Session
from shmgen.runtime import ServiceClient, ServiceServer
from tests.softplc import compile_st

from ..rigs.load_bridge import RATES, bridged
from ..support.dds import Domain
from ..support.ros1 import LIMIT, PROMPTLY, Bridge
from .conftest import Errors
from .peers import running

CONFIG = """
task_interval = 1
[types]
time = "LTIME"
[bounds]
sensor_msgs = 4
[[topics]]
topic = "{topic}/joints"
type = "sensor_msgs/JointState"
depth = 8
[[topics]]
topic = "{topic}/joints_back"
type = "sensor_msgs/JointState"
direction = "from_plc"
depth = 8
"""
SERVICES = """
path = ["msgs"]
[strings]
default = 16
[[services]]
service = "{topic}/start"
type = "cell_msgs/Start"
timeout = 2.0
[[services]]
service = "{topic}/stop"
type = "cell_msgs/Start"
server = "ros"
timeout = 2.0

[[actions]]
action = "{topic}/move"
type = "cell_msgs/Move"
"""
PROGRAM = """
PROGRAM PRG_Echo
GVL_Ros.{name}_joints.xNewest := FALSE;
GVL_Ros.{name}_joints_back.xSend := GVL_Ros.{name}_joints.xNewData;
GVL_Ros.{name}_joints_back.Msg := GVL_Ros.{name}_joints.Msg;
GVL_Ros.{name}_joints_back.Msg.position[0] := GVL_Ros.{name}_joints.Msg.position[0] + 1.0;
END_PROGRAM
"""
ANSWER = f"^took {re.escape('12.345678901 base shoulder elbow 1.5 -1.25 | 0 1')}$"
"""The line that the peer prints when its message returns from the PLC program."""
TYPE = "sensor_msgs::msg::dds_::JointState_"


@pytest.fixture
def library(cell: Domain, topic: str) -> Path:
    """The compiled PLC program for the topics of CONFIG."""
    (cell.folder / "shmgen.toml").write_text(CONFIG.format(topic=topic))
    config = load(cell.folder / "shmgen.toml", "shmgen.toml", Report())
    texts = {path: text for path, text in pipeline.generate(config, []).items() if path.endswith(".st")}
    name = topic.strip("/").replace("/", "_")
    compile_st({**texts, "PRG_Echo.st": PROGRAM.format(name=name)}, cell.folder / "plc")
    return cell.folder / "plc" / "plc.so"


@pytest.mark.sample("[cyclone]")
def test_plc_program_echoes_after_restarts(peer: Path, cell: Domain, library: Path, domain: int, topic: str) -> None:
    def start_plc() -> Bridge:
        task = Bridge(cell.start([cell.python, "-m", "tests.softplc.task", library, "PRG_Ros", "PRG_Echo"]))
        task.wait_for_line("^running")
        return task

    tasks = [TYPE, "-", topic_name(f"{topic}/joints")]
    tasks += [TYPE, topic_name(f"{topic}/joints_back"), topic_name(f"{topic}/again")]
    bridge, plc = cell.bridge(), start_plc()
    with running(peer, domain, "reliable", "volatile", *tasks) as remote:
        remote.wait_for_line(ANSWER, 3)

        bridge.kill()
        remote.lines.clear()
        bridge = cell.bridge()
        remote.wait_for_line(ANSWER, 3)

        plc.kill()
        remote.lines.clear()
        start_plc()
        remote.wait_for_line(ANSWER, 3)
    with running(peer, domain, "reliable", "volatile", *tasks) as remote:
        remote.wait_for_line(ANSWER, 3)
        assert not [line for line in remote.lines if line.startswith("took") and not re.match(ANSWER, line)]
    assert bridge.stop(signal.SIGTERM) < PROMPTLY
    bridge.wait_for_line("/joints_back +[0-9]+ passed")


@pytest.mark.slow
def test_services_pass_both_ways(cell: Domain, graph: backend.Graph, topic: str) -> None:
    """Use Python as the PLC, and the dds backend in this process as the ROS client and server."""
    file = cell.folder / "msgs" / "cell_msgs" / "srv" / "Start.srv"
    file.parent.mkdir(parents=True)
    file.write_text("int32 part\nstring word\n---\nbool success\nstring message\n")
    move = cell.folder / "msgs" / "cell_msgs" / "action" / "Move.action"
    move.parent.mkdir()
    move.write_text("int32 to\n---\nint32 at\n---\nint32 at\n")
    bridge = cell.bridge(SERVICES.format(topic=topic))
    served, called = services(Session(load(cell.folder / "shmgen.toml", "shmgen.toml", Report())))

    server_class = call_class(ServiceServer, served.kinds)
    stop = threading.Event()

    def serve() -> None:
        with server_class(served.entry.name) as server:
            while not stop.is_set():
                server.serve(lambda call: SimpleNamespace(success=True, message=f"{call.word} {call.part}"), 0.05)

    thread = threading.Thread(target=serve)
    thread.start()
    client = graph.client(served.wire)
    for part in (1, 2):
        request = client.new()
        request.part, request.word = part, "part"
        assert client.call(request, LIMIT).message == f"part {part}"
    request.word = "a word that is longer than the bound"
    with pytest.raises(NoAnswer):
        client.call(request, 1.0)
    bridge.wait_for_line("/start: .*word: 36 bytes of UTF-8, capacity 16")
    stop.set()
    thread.join()

    graph.serve(called.wire, lambda request, answer: setattr(answer, "message", request.word.upper()), Errors())
    with call_class(ServiceClient, called.kinds)(called.entry.name) as plc:
        assert plc.call(SimpleNamespace(part=3, word="stop"), LIMIT).message == "STOP"


@pytest.mark.slow
def test_short_load_run_counts_every_lost_message(cell: Domain, topic: str) -> None:
    """Run the load test of `make load-bridge` for 3 s."""
    result = bridged(cell, topic, 3)
    assert result.run.sent == 3 * sum(RATES.values())
    assert result.lost == 0
