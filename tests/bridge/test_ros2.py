"""The ROS 2 backend against the stand-in of rclpy_stand_in.py: no rclpy can be had here."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen import pipeline
from shmgen.bridge import plan
from shmgen.bridge.backend import NoAnswer, Node, ServiceWire
from shmgen.bridge.counters import Counters
from shmgen.bridge.diagnostics import Reporter
from shmgen.bridge.from_plc import FromPlc
from shmgen.bridge.to_plc import ToPlc
from shmgen.config import Config, load
from shmgen.diagnostics import Report
from shmgen.live.classes import publisher, subscriber
from shmgen.live.session import Session
from shmgen.model import TypeName
from shmgen.runtime import Time

from . import rclpy_stand_in as stand_in

THING = """
std_msgs/Header header
byte flags
byte[] more
bool on
char letter
uint8[] data
float64[3] at
string[<=3] words
Part[<=2] parts
builtin_interfaces/Time[<=2] times
"""
PART = "string name\nbyte[2] codes\nbuiltin_interfaces/Duration took\n"
SERVICE = "Part[<=2] parts\n---\nbyte code\nstring text\n"


@pytest.fixture
def config(tmp_path: Path, topic: str) -> Config:
    folder = tmp_path / "msgs" / "cell_msgs"
    for name, text in (("msg/Thing.msg", THING), ("msg/Part.msg", PART), ("srv/Ask.srv", SERVICE)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (tmp_path / "shmgen.toml").write_text(
        'path = ["msgs"]\n[bridge]\nnode = "cell"\ndomain = 7\n[bounds]\ncell_msgs = 4\n'
        f'[[topics]]\ntopic = "{topic}"\ntype = "cell_msgs/Thing"\nqos = "best_effort"\n'
        f'[[topics]]\ntopic = "{topic}_back"\ntype = "cell_msgs/Thing"\ndirection = "from_plc"\nlatch = true\n'
    )
    return load(tmp_path / "shmgen.toml", "shmgen.toml", Report())


@pytest.fixture
def schema(config: Config) -> Any:
    return pipeline.read(config, ["cell_msgs/Thing", "cell_msgs/Ask", plan.DIAGNOSTICS])


@pytest.fixture
def connected(config: Config, schema: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    stand_in.install(monkeypatch, schema.messages)
    backend = importlib.import_module("shmgen.bridge.ros2").connect(
        Node(config.bridge.node, config.bridge.domain, told.append, lambda: False, ("--ros-args",))
    )
    yield backend
    backend.close()
    told.clear()


told: list[str] = []


def soon(condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def thing() -> Any:
    """A message of the strict classes, filled as a ROS program would."""
    made = stand_in.classes["cell_msgs/msg/Thing"]()
    made.header.stamp.sec, made.header.stamp.nanosec, made.header.frame_id = int(time.time()), 5_000_000, "cell"
    made.flags, made.more, made.on, made.letter = b"\x81", [b"\1", b"\2"], True, 65
    made.data, made.at, made.words = [1, 2, 3], [0.5, -1.0, 2.0], ["a", "ä"]
    made.parts = [stand_in.classes["cell_msgs/msg/Part"]()]
    made.parts[0].name, made.parts[0].codes, made.parts[0].took.sec = "part", [b"\3", b"\4"], 9
    made.times = [stand_in.classes["builtin_interfaces/msg/Time"]()]
    made.times[0].sec = int(time.time())
    return made


def plain(value: Any) -> Any:
    if isinstance(value, list):
        return [plain(item) for item in value]
    return {name: plain(item) for name, item in vars(value).items()} if hasattr(value, "__dict__") else value


def test_there_and_back(connected: Any, config: Config, topic: str) -> None:
    """Through both regions, unchanged, by classes that take no value but of their own types."""
    stopping = threading.Event()
    there, back = (
        (ToPlc if route.to_plc else FromPlc)(route, Counters(route.topic.topic, told.append), stopping)
        for route in plan.routes(Session(config))
    )
    assert isinstance(there, ToPlc)
    assert isinstance(back, FromPlc)
    try:
        back.join(connected)
        there.join(connected)
        assert stand_in.init.arguments == (["--ros-args"], 7, "NO")  # type: ignore[attr-defined]
        (subscription,), (made,) = stand_in.subscriptions, stand_in.publishers
        assert (subscription.qos.reliability.name, subscription.qos.durability.name) == ("BEST_EFFORT", "VOLATILE")
        assert (made.qos.reliability.name, made.qos.durability.name) == ("RELIABLE", "TRANSIENT_LOCAL")
        assert subscription.qos.depth == 1000
        heard: list[Any] = []
        stand_in.Node.create_subscription(
            connected._node, made.kind, f"{topic}_back", heard.append, None, callback_group=None
        )

        sent = thing()
        with subscriber(there.route.kind, topic, 1) as plc:
            connected._executor.work.put(lambda: subscription.callback(sent))
            seen = plc.wait(10)
        with publisher(back.route.kind, f"{topic}_back", 1) as plc:
            plc.publish(seen)
            soon(lambda: heard)
        assert plain(heard[0]) == plain(sent)
        assert told == []
    finally:
        stopping.set()
        there.close()
        back.close()


def test_diagnostics_are_of_its_own_classes(connected: Any, config: Config) -> None:
    outlet = connected.publisher(plan.diagnostics(Session(config)))
    heard: list[Any] = []
    connected._node.create_subscription(None, "/diagnostics", heard.append, None, callback_group=None)
    message = outlet.new()
    value = SimpleNamespace(key="rate", value="1.0")
    status = SimpleNamespace(level=3, name="a", message="b", hardware_id="", values=[value])
    Reporter("cell").fill(message, [], Time(5, 6))
    message.status = [status]
    outlet.send(message)
    soon(lambda: heard)
    assert (heard[0].status[0].level, heard[0].status[0].values[0].key) == (b"\3", "rate")
    assert plain(heard[0].header.stamp) == {"sec": 5, "nanosec": 6}


def wire(schema: Any) -> ServiceWire:
    halves = (TypeName("cell_msgs", "srv", f"Ask_{half}") for half in ("Request", "Response"))
    return ServiceWire("/ask", *(plan.closure(schema, name) for name in halves))


def test_a_service_both_ways(connected: Any, schema: Any) -> None:
    def answer(request: Any, response: Any) -> None:
        if not request.parts:
            raise NoAnswer("the PLC is off")
        response.code, response.text = request.parts[0].codes[1], request.parts[0].name

    caller = connected.client(wire(schema))
    with pytest.raises(NoAnswer, match=r"no server within 0\.1 s"):
        caller.call(caller.new(), 0.1)
    connected.serve(wire(schema), answer)
    request = caller.new()
    request.parts = [SimpleNamespace(name="x", codes=[1, 200], took=Time())]
    response = caller.call(request, 5.0)
    assert (response.code, response.text) == (200, "x")
    with pytest.raises(NoAnswer, match=r"no answer within 0\.3 s"):
        caller.call(caller.new(), 0.3)
    soon(lambda: told == ["the PLC is off"])


def test_a_type_that_is_not_there_or_other(connected: Any, config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    route = plan.routes(Session(config))[0]
    name = "cell_msgs/msg/Thing"
    monkeypatch.setitem(stand_in.classes, name, stand_in._plain("Thing", {"header": (int, 0)}))
    with pytest.raises(ValueError, match="of this ROS has the fields header, and not header, flags"):
        connected.publisher(route.wire)

    def absent(name: str) -> Any:
        raise ModuleNotFoundError("No module named 'cell_msgs'")

    monkeypatch.setattr(importlib.import_module("shmgen.bridge.ros2_types"), "get_message", absent)
    with pytest.raises(ValueError, match="is not installed in this ROS: No module named 'cell_msgs'\n  hint: build"):
        connected.publisher(route.wire)
