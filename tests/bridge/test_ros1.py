"""Test that messages and calls of a real ROS 1 pass the bridge, the regions and a PLC program, and return."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xmlrpc.client import ServerProxy

import pytest
from ruamel.yaml import YAML

from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline
from shmgen.live.classes import publisher
from shmgen.live.session import Session
from tests.softplc import compile_st

from ..conftest import REPOSITORY
from ..support.ros1 import LIMIT, Graph, Peer, wait_for

STATUS = """
std_msgs/Header header
uint8 RUNNING=2
uint8 mode
string[] lines
Part[] parts
duration took
"""
PART = "string name\nfloat32[3] size\n"

THROUGH = """
source = "noetic"
path = ["msgs"]
task_interval = 1

[bounds]
sensor_msgs = 4
cell_msgs = 4

[[topics]]
topic = "{space}/pose"
type = "geometry_msgs/PoseStamped"

[[topics]]
topic = "{space}/pose_back"
type = "geometry_msgs/PoseStamped"
direction = "from_plc"

[[topics]]
topic = "{space}/joints"
type = "sensor_msgs/JointState"
depth = 8

[[topics]]
topic = "{space}/joints_back"
type = "sensor_msgs/JointState"
direction = "from_plc"
depth = 8

[[topics]]
topic = "{space}/status"
type = "cell_msgs/Status"

[[topics]]
topic = "{space}/status_back"
type = "cell_msgs/Status"
direction = "from_plc"

[[services]]
service = "{space}/flag"
type = "std_srvs/SetBool"
timeout = 5.0

[[services]]
service = "{space}/ask"
type = "std_srvs/SetBool"
server = "ros"
timeout = 5.0
"""
SETBOOL = "bool data # e.g. for hardware enabling / disabling\n---\nbool success\nstring message\n"
"""The definition for Debian's python3-std-srvs, which contains only the class."""

PROGRAM = """
PROGRAM PRG_Echo
GVL_Ros.{name}_pose_back.xSend := GVL_Ros.{name}_pose.xNewData;
GVL_Ros.{name}_pose_back.Msg := GVL_Ros.{name}_pose.Msg;
GVL_Ros.{name}_pose_back.Msg.pose.position.x := GVL_Ros.{name}_pose.Msg.pose.position.x + 1.0;
GVL_Ros.{name}_joints.xNewest := FALSE;
GVL_Ros.{name}_joints_back.xSend := GVL_Ros.{name}_joints.xNewData;
GVL_Ros.{name}_joints_back.Msg := GVL_Ros.{name}_joints.Msg;
GVL_Ros.{name}_status_back.xSend := GVL_Ros.{name}_status.xNewData;
GVL_Ros.{name}_status_back.Msg := GVL_Ros.{name}_status.Msg;
// The PLC answers a call of ROS by calling ROS.
GVL_Ros.{name}_ask.xExecute := GVL_Ros.{name}_flag.xExecute;
GVL_Ros.{name}_ask.tTimeout := T#5S;
GVL_Ros.{name}_ask.Request := GVL_Ros.{name}_flag.Request;
GVL_Ros.{name}_flag.xDone := GVL_Ros.{name}_ask.xDone;
GVL_Ros.{name}_flag.xFailed := GVL_Ros.{name}_ask.xError;
GVL_Ros.{name}_flag.Response := GVL_Ros.{name}_ask.Response;
END_PROGRAM
"""


class Softplc:
    """A process that runs the program every millisecond, like a PLC task."""

    def __init__(self, folder: Path, space: str) -> None:
        config = load(folder / "shmgen.toml", "shmgen.toml", Report())
        texts = {path: text for path, text in pipeline.generate(config, []).items() if path.endswith(".st")}
        compile_st({**texts, "PRG_Echo.st": PROGRAM.format(name=space.strip("/"))}, folder / "plc")
        self.command = [sys.executable, "-m", "tests.softplc.task", folder / "plc" / "plc.so", "PRG_Ros", "PRG_Echo"]
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(self.command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout
        assert self.process.stdout.readline() == "running\n"

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def plc(graph: Graph, space: str) -> Iterator[Softplc]:
    """A PLC that runs PROGRAM over the topics of THROUGH."""
    graph.generate("cell_msgs", {"msg/Status.msg": STATUS, "msg/Part.msg": PART})
    definition = graph.folder / "msgs" / "std_srvs" / "srv" / "SetBool.srv"
    definition.parent.mkdir(parents=True)
    definition.write_text(SETBOOL)
    (graph.folder / "shmgen.toml").write_text(THROUGH.format(space=space))
    softplc = Softplc(graph.folder, space)
    yield softplc
    softplc.kill()


def test_messages_and_calls_return_from_a_plc_program(graph: Graph, plc: Softplc, space: str) -> None:
    """Restart the master, the bridge and the PLC one after the other. Each time, messages pass again without help."""
    bridge = graph.bridge()

    # Use the commands of ros_comm and the installed class of genpy.
    echo = graph.command("rostopic", "echo", "-n", "1", f"{space}/pose_back")
    values = "{header: {frame_id: map}, pose: {position: {x: 1.5, y: -2}, orientation: {w: 1}}}"
    pub = graph.command("rostopic", "pub", "-r", "20", f"{space}/pose", "geometry_msgs/PoseStamped", values)
    printed = YAML(typ="safe").load(echo.communicate(timeout=LIMIT)[0].partition("---")[0])
    pub.kill()
    assert printed["pose"]["position"] == {"x": 2.5, "y": -2, "z": 0}
    assert printed["pose"]["orientation"] == {"x": 0, "y": 0, "z": 0, "w": 1}
    assert printed["header"]["frame_id"] == "map"
    assert abs(printed["header"]["stamp"]["secs"] - time.time()) < LIMIT  # the bridge replaced the stamp of 0

    # Use strings, sequences, times, and a message of this test. Only the peer has its Python module.
    peer = graph.peer()
    for name, kind in (("joints", "sensor_msgs/JointState"), ("status", "cell_msgs/Status")):
        peer.ask(do="subscribe", topic=f"{space}/{name}_back", type=kind)
        peer.ask(do="advertise", topic=f"{space}/{name}", type=kind)
        assert peer.ask(do="connected", topic=f"{space}/{name}")
    header = {"seq": 1, "stamp": {"secs": int(time.time()), "nsecs": 250_000_000}, "frame_id": "cell"}
    status = {
        "header": header,
        "mode": 2,
        "lines": ["", "Grüße"],
        "parts": [{"name": "a", "size": [1.0, 2.5, -3.0]}, {"name": "b", "size": [0.0, 0.0, 0.0]}],
        "took": {"secs": 3, "nsecs": 4_000_000},
    }
    assert echo_messages(peer, space, "status", [status]) == [status]
    empty = {**status, "lines": [], "parts": [], "mode": 0}
    assert echo_messages(peer, space, "status", [empty]) == [{**empty, "header": {**header, "seq": 2}}]

    # Send a burst of as many messages as fit into `depth`. Retry after a loss: a block that finds its region locked
    # sends nothing in that cycle, and PROGRAM does not check.
    burst = [{"name": ["a"], "position": [float(n)], "velocity": [], "effort": []} for n in range(1, 9)]
    bursts = ([without_field(msg, "header") for msg in echo_messages(peer, space, "joints", burst)] for _ in range(5))
    assert burst in bursts

    # Call a service that the PLC serves by calling another service.
    answers = [{"success": True, "message": "ja"}, None, {"success": False, "message": "nein"}]
    peer.ask(do="serve", service=f"{space}/ask", type="std_srvs/SetBool", answers=answers)
    assert 'success: True\nmessage: "ja"' in call_service(graph, f"{space}/flag", "data: true")
    assert re.search(r"the server reported that call \d+ failed", call_service(graph, f"{space}/flag", "data: true"))
    assert 'success: False\nmessage: "nein"' in call_service(graph, f"{space}/flag", "data: false")

    def message_returns() -> bool:
        peer.ask(do="forget", topic=f"{space}/joints_back")
        peer.ask(do="publish", topic=f"{space}/joints", messages=[{"name": ["again"]}])
        return any(
            msg["name"] == ["again"] for msg in peer.ask(do="take", topic=f"{space}/joints_back", count=1, timeout=0.5)
        )

    graph.stop_master()
    bridge.wait_for_line("the ROS master is unreachable")
    assert message_returns(), "connections survive the end of the master"
    graph.start_master()
    bridge.wait_for_line("registering again")
    peer = graph.peer()  # this peer knows only the new master
    peer.ask(do="subscribe", topic=f"{space}/joints_back", type="sensor_msgs/JointState")
    peer.ask(do="advertise", topic=f"{space}/joints", type="sensor_msgs/JointState")
    wait_for(message_returns, "a message by way of the new master")

    bridge.kill()
    graph.bridge()
    wait_for(message_returns, "a message by way of the new bridge")

    plc.kill()
    plc.start()
    wait_for(message_returns, "a message by way of the new PLC")


STOPS_WITHIN = 5.0
"""Seconds on a machine that also runs other tests; on an idle machine, the stop takes 0.6 s."""

LATCHED = """
source = "noetic"
[bridge]
diagnostics = 0.2
node = "cell_bridge"
[strings]
"std_msgs/String.data" = 8
[[topics]]
topic = "{space}/word"
type = "std_msgs/String"
[[topics]]
topic = "{space}/state"
type = "std_msgs/String"
direction = "from_plc"
latch = true
"""


def test_bridge_stops_promptly_without_a_master(graph: Graph, space: str) -> None:
    """Stop promptly while the bridge waits for a master, and after its master has ended."""
    graph.stop_master()
    bridge = graph.bridge(LATCHED.format(space=space), ready=False)
    bridge.wait_for_line(f"no ROS master at http://127.0.0.1:{graph.port} .* waiting for one")
    assert bridge.stop(signal.SIGTERM) < STOPS_WITHIN

    bridge = graph.bridge(ready=False)
    bridge.wait_for_line("waiting for one")
    graph.start_master()
    bridge.wait_for_line("running")
    graph.stop_master()
    bridge.wait_for_line("the ROS master is unreachable")
    assert bridge.stop(signal.SIGINT) < STOPS_WITHIN


def test_diagnostics_latch_and_counters(graph: Graph, space: str) -> None:
    bridge = graph.bridge(LATCHED.format(space=space), "__name:=cell_4")
    bridge.wait_for_line(rf"{space}/word +-> PLC  std_msgs/String  /dev/shm/{space[1:]}.word")
    kind = Session(load(graph.folder / "shmgen.toml", "shmgen.toml", Report())).classes(["std_msgs/String"])
    peer = graph.peer()
    with ServerProxy(f"http://127.0.0.1:{graph.port}") as master:
        assert master.lookupNode("/test", "/cell_4")[0] == 1  # type: ignore[index]
    with publisher(kind["std_msgs/msg/String"], f"{space}/state", 1) as plc:
        plc.publish(SimpleNamespace(data="ready"))
        peer.ask(do="advertise", topic=f"{space}/word", type="std_msgs/String")
        assert peer.ask(do="connected", topic=f"{space}/word")
        peer.ask(do="publish", topic=f"{space}/word", messages=[{"data": "go"}, *[{"data": "much too long"}] * 3])
        bridge.wait_for_line("rejected: data: 13 bytes of UTF-8, capacity 8")
        peer.ask(do="subscribe", topic=f"{space}/state", type="std_msgs/String")  # after it was published
        assert peer.ask(do="take", topic=f"{space}/state", count=1) == [{"data": "ready"}]
    bridge.process.send_signal(signal.SIGUSR1)
    bridge.wait_for_line("/word   1 passed, 3 rejected")

    peer.ask(do="subscribe", topic="/diagnostics", type="diagnostic_msgs/DiagnosticArray")
    array = peer.ask(do="take", topic="/diagnostics", count=1)[0]
    assert abs(array["header"]["stamp"]["secs"] - time.time()) < LIMIT
    word, state = array["status"]
    assert (word["name"], state["name"]) == (f"cell_4: {space}/word", f"cell_4: {space}/state")
    values = {value["key"]: value["value"] for value in word["values"]}
    assert (values["passed"], values["rejected"], values["type"]) == ("1", "3", "std_msgs/String")
    assert "data: 13 bytes" in values["last complaint"]
    assert bridge.stop(signal.SIGTERM) < STOPS_WITHIN
    bridge.wait_for_line("/state  1 passed")


def test_definition_of_another_ros_is_reported(graph: Graph, space: str) -> None:
    topic = f'[[topics]]\ntopic = "{space}/info"\ntype = '
    bounds = "[bounds]\nsensor_msgs = 5\n"
    bridge = graph.bridge(f'source = "jazzy"\n{bounds}{topic}"sensor_msgs/CameraInfo"', ready=False)
    bridge.wait_for_line(
        r".*/info: error\[SHM704\]: sensor_msgs/CameraInfo of this ROS differs from shmgen's definition: .*'d'"
    )
    bridge.wait_for_line('hint: set source = "..." in shmgen.toml')
    file = graph.folder / "cell_msgs" / "msg" / "Two.msg"
    file.parent.mkdir(parents=True)
    file.write_text("string<=5 word\n")
    other = graph.bridge(f'path = ["."]\n{topic.replace("info", "two")}"cell_msgs/Two"', ready=False)
    other.wait_for_line(r"cell_msgs/Two: error\[SHM704\]: ROS 1 cannot read cell_msgs/msg/Two.msg")
    assert (bridge.process.wait(LIMIT), other.process.wait(LIMIT)) == (1, 1)


def call_service(graph: Graph, service: str, values: str) -> str:
    """Return the output of `rosservice call`, errors included."""
    printed: str = graph.command("rosservice", "call", service, values).communicate(timeout=LIMIT)[0]
    return printed + (graph.folder / "log").read_text()


def without_field(message: dict[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in message.items() if key != name}


def echo_messages(peer: Peer, space: str, name: str, messages: list[Any]) -> Any:
    """Publish the messages, and return the messages that come back within 5 s."""
    peer.ask(do="forget", topic=f"{space}/{name}_back")
    peer.ask(do="publish", topic=f"{space}/{name}", messages=messages)
    return peer.ask(do="take", topic=f"{space}/{name}_back", count=len(messages), timeout=5.0)
