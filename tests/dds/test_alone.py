"""Every end of the bridge lives and dies alone: what one topic meets, no other does, and it comes back."""

from __future__ import annotations

import signal
import socket
import time
from typing import Any

import pytest

from shmgen.bridge.dds import backend
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.core.model import Schema
from shmgen.live.classes import publisher, subscriber
from shmgen.live.session import Session
from shmgen.runtime import Publisher, Subscriber
from shmgen.runtime.region import header as h

from ..support.dds import Domain
from ..support.ros1 import Bridge
from ..support.standby import Onlooker, a_plc_writes, file_of, made_anew
from .conftest import Taken, until, wire

LONGEST = 1.0
"""Seconds that a heartbeat may stand still on a topic that nobody touched. A PLC's region is watched for 1.1 s."""
ENTRY = '[[topics]]\ntopic = "{topic}"\ntype = "geometry_msgs/Pose"\n{keys}\n'
ERROR = 2


class Cell:
    """A bridge of topics `a` to `f` towards the PLC, `back` from it; a publisher of each, and the diagnostics."""

    def __init__(self, domain: Domain, graph: backend.Graph, schema: Schema, topic: str) -> None:
        self.domain, self.topic = domain, topic
        keys = dict.fromkeys("abcdef", "") | {"back": 'direction = "from_plc"\ndepth = 8'}
        self.entries = {name: ENTRY.format(topic=f"{topic}/{name}", keys=keys[name]) for name in keys}
        self.logged: dict[str, tuple[int, str, dict[str, str]]] = {}
        graph.subscribe(wire(schema, "/diagnostics", "diagnostic_msgs/DiagnosticArray"), Taken(self._diagnosed))
        self.bridge = domain.bridge(self.config())
        self.outlets = {
            name: graph.publisher(wire(schema, f"{topic}/{name}", "geometry_msgs/Pose")) for name in "abcdef"
        }
        self.back: list[float] = []
        graph.subscribe(
            wire(schema, f"{topic}/back", "geometry_msgs/Pose"),
            Taken(lambda message: self.back.append(message.position.x)),
        )
        kinds = Session(load(domain.folder / "shmgen.toml", "shmgen.toml", Report())).classes(["geometry_msgs/Pose"])
        self.kind = kinds["geometry_msgs/msg/Pose"]

    def config(self) -> str:
        return "[bridge]\ndiagnostics = 0.2\n" + "".join(self.entries.values())

    def reader(self, name: str) -> Subscriber[Any]:
        return subscriber(self.kind, f"{self.topic}/{name}", 1)

    def writer(self, name: str) -> Publisher[Any]:
        return publisher(self.kind, f"{self.topic}/{name}", 8)

    def onlooker(self, but: str) -> Onlooker:
        return Onlooker(f"{self.topic}/{name}" for name in "abcdef" if name not in but)

    def flows(self, name: str) -> bool:
        """Whether what ROS sends now arrives in the region."""
        outlet = self.outlets[name]
        with self.reader(name) as reader:
            reader.read()
            outlet.send(outlet.new())
            return reader.wait(0.3) is not None

    def state(self, name: str) -> tuple[int, str]:
        return self.logged.get(f"{self.topic}/{name}", (-1, "", {}))[:2]

    def count(self, name: str) -> dict[str, str]:
        return self.logged.get(f"{self.topic}/{name}", (-1, "", {}))[2]

    def _diagnosed(self, array: Any) -> None:
        for one in array.status:
            self.logged[one.name.partition(": ")[2]] = (
                int.from_bytes(one.level, "little") if isinstance(one.level, bytes) else one.level,
                one.message,
                {value.key: value.value for value in one.values},
            )


@pytest.fixture
def six(cell: Domain, graph: backend.Graph, schema: Schema, topic: str) -> Cell:
    made = Cell(cell, graph, schema, topic)
    for name in "abcdef":
        until(lambda name=name: made.flows(name))
    time.sleep(0.5)  # so that the diagnostics know
    return made


def logged(bridge: Bridge, text: str) -> int:
    return sum(text in line for line in list(bridge.lines))


@pytest.mark.slow
def test_a_topic_that_a_plc_takes_over_is_sought_again(six: Cell) -> None:
    with six.onlooker("a") as looks, a_plc_writes(f"{six.topic}/a"):
        until(lambda: six.state("a")[0] == ERROR)
        for _ in range(5):
            six.outlets["a"].send(six.outlets["a"].new())
        until(lambda: int(six.count("a")["missed"]) == 5)
        assert all(six.flows(name) for name in "bcdef")
        time.sleep(1.5)
        assert (six.state("a")[0], six.state("b")[0]) == (ERROR, 0)  # as long as its cause
        assert "a PLC" in six.state("a")[1]
    until(lambda: six.flows("a"))
    until(lambda: six.state("a")[0] == 0)
    assert max(looks.longest.values()) < LONGEST, looks.longest
    assert logged(six.bridge, "has taken the topic over") <= 1
    assert logged(six.bridge, f"{six.topic}/a: the region is open again") == 1
    six.bridge.stop(signal.SIGTERM)


@pytest.mark.slow
def test_a_region_that_a_plc_made_anew_holds_up_no_other(six: Cell) -> None:
    """It is watched for 1.1 s, for nobody knows whether that PLC still runs."""

    def by_a_plc(words: memoryview) -> None:
        words[h.WRITER], words[h.HEARTBEAT] = h.PLC, 77

    with six.onlooker("a") as looks:
        for _ in range(2):
            made_anew(f"{six.topic}/a", by_a_plc)
            until(lambda: six.flows("a"))
    assert max(looks.longest.values()) < LONGEST, looks.longest


@pytest.mark.slow
def test_files_that_are_no_regions_hold_up_no_other(six: Cell) -> None:
    strange = file_of(f"{six.topic}/strange_")
    with six.onlooker("abcde") as looks:
        for name in "abcde":
            strange.write_bytes(b"x" * 5000)
            strange.rename(file_of(f"{six.topic}/{name}"))
        until(lambda: all(six.state(name)[0] == ERROR for name in "abcde"))
        time.sleep(1.0)
        assert all(six.state(name)[0] == ERROR and "not a region of shmgen" in six.state(name)[1] for name in "abcde")
        for name in "abcde":
            file_of(f"{six.topic}/{name}").unlink()
        until(lambda: all(six.flows(name) for name in "abcde"))
    assert looks.longest[f"{six.topic}/f"] < LONGEST
    assert logged(six.bridge, "not a region of shmgen") == 5


@pytest.mark.slow
def test_what_waits_in_a_region_that_is_removed_still_crosses(six: Cell) -> None:
    """Nothing of what the PLC wrote is lost uncounted when it makes its region anew."""
    written = 0
    for _ in range(10):
        with six.writer("back") as writer:
            for _ in range(15):
                message = six.kind()
                message.position.x = written = written + 1
                writer.publish(message)
                time.sleep(0.02)
            file_of(f"{six.topic}/back").unlink()
        time.sleep(0.05)

    def counted() -> bool:
        count = six.count("back")
        return int(count["passed"]) + int(count["missed"]) == written and len(six.back) == int(count["passed"])

    until(counted)
    assert six.back == sorted(six.back)


def test_each_message_is_in_one_counter(six: Cell) -> None:
    """Those that pass, and those that come while another writes; see ros2/test_identity.py, rigs/soak_bridge.py."""
    names = ("passed", "rejected", "missed", "refused", "lost", "rate limited")

    def total() -> int:
        return sum(int(six.count("a")[name]) for name in names)

    outlet, before = six.outlets["a"], total()

    def send(count: int) -> None:
        for _ in range(count):
            outlet.send(outlet.new())
            time.sleep(0.002)

    send(50)
    with a_plc_writes(f"{six.topic}/a"):
        send(100)
    made_anew(f"{six.topic}/a", lambda words: None)
    send(50)
    until(lambda: total() - before == 200)
    assert int(six.count("a")["missed"]) > 50


# --- SIGHUP and systemd ---------------------------------------------------------------------------------------


def test_a_reload_changes_what_has_changed_and_nothing_else(six: Cell, graph: backend.Graph, schema: Schema) -> None:
    before = file_of(f"{six.topic}/b").stat().st_ino
    passed = int(six.count("b")["passed"])
    new = ENTRY.format(topic=f"{six.topic}/new", keys="")
    del six.entries["a"]
    six.entries["c"] = ENTRY.format(topic=f"{six.topic}/c", keys="rate = 5")
    (six.domain.folder / "shmgen.toml").write_text("# a comment moves all lines\n" + six.config() + new)
    with six.onlooker("ac") as looks:
        six.bridge.process.send_signal(signal.SIGHUP)
        six.bridge.wait_for_line("shmgen.toml was read again: topics: 7, services: 0")
        outlet = six.outlets["new"] = graph.publisher(wire(schema, f"{six.topic}/new", "geometry_msgs/Pose"))
        until(lambda: six.flows("new"))
        until(lambda: six.flows("c"))
        assert six.flows("b")
        assert not six.flows("a")
        assert outlet
    assert max(looks.longest.values()) < LONGEST, looks.longest
    assert file_of(f"{six.topic}/b").stat().st_ino == before
    until(lambda: int(six.count("b")["passed"]) > passed)
    with publisher(six.kind, f"{six.topic}/a", 1):
        pass  # nobody else claims it any more
    (six.domain.folder / "shmgen.toml").write_text('[[topics]]\ntopic = "/x"\ntyp = "geometry_msgs/Pose"\n')
    six.bridge.process.send_signal(signal.SIGHUP)
    six.bridge.wait_for_line("shmgen.toml was not reloaded: .*typ")
    assert six.flows("b")
    six.bridge.stop(signal.SIGTERM)
    assert not logged(six.bridge, "Traceback")


@pytest.mark.slow
def test_systemd_hears_that_it_is_ready_alive_and_ending(cell: Domain, topic: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address := str(cell.folder / "notify"))
        manager.settimeout(20)
        cell.environment["NOTIFY_SOCKET"] = address
        bridge = cell.bridge(ENTRY.format(topic=topic, keys=""))

        def hear(wanted: str) -> list[str]:
            heard = [manager.recv(4096).decode()]
            while wanted not in heard[-1]:
                heard.append(manager.recv(4096).decode())
            return heard

        assert hear("READY=1") == ["READY=1"]
        hear("WATCHDOG=1")
        bridge.process.send_signal(signal.SIGHUP)
        (reloading,) = [line for line in hear("READY=1") if "RELOADING" in line]
        assert 0 <= time.monotonic_ns() // 1000 - int(reloading.partition("MONOTONIC_USEC=")[2]) < 20e6
        bridge.stop(signal.SIGTERM)
        hear("STOPPING=1")
