"""Test that topics of a bridge fail and recover independently: an error of one topic does not disturb the others."""

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
from .conftest import Errors, until, wire

LONGEST = 1.0
"""Seconds that the heartbeat of an undisturbed topic may pause. The bridge watches a PLC's region for 1.1 s."""
ENTRY = '[[topics]]\ntopic = "{topic}"\ntype = "geometry_msgs/Pose"\n{keys}\n'
ERROR = 2


class BridgeRig:
    """A bridge with topics `a` to `f` to the PLC and `back` from it, a publisher of each, and the diagnostics."""

    def __init__(self, domain: Domain, graph: backend.Graph, schema: Schema, topic: str) -> None:
        self.domain, self.topic = domain, topic
        keys = dict.fromkeys("abcdef", "") | {"back": 'direction = "from_plc"\ndepth = 8'}
        self.entries = {name: ENTRY.format(topic=f"{topic}/{name}", keys=keys[name]) for name in keys}
        self.logged: dict[str, tuple[int, str, dict[str, str]]] = {}
        graph.subscribe(wire(schema, "/diagnostics", "diagnostic_msgs/DiagnosticArray"), self._diagnosed, Errors())
        self.bridge = domain.bridge(self.config())
        self.outlets = {
            name: graph.publisher(wire(schema, f"{topic}/{name}", "geometry_msgs/Pose")) for name in "abcdef"
        }
        self.back: list[float] = []
        graph.subscribe(
            wire(schema, f"{topic}/back", "geometry_msgs/Pose"),
            lambda message: self.back.append(message.position.x),
            Errors(),
        )
        kinds = Session(load(domain.folder / "shmgen.toml", "shmgen.toml", Report())).classes(["geometry_msgs/Pose"])
        self.kind = kinds["geometry_msgs/msg/Pose"]

    def config(self) -> str:
        return "[bridge]\ndiagnostics = 0.2\n" + "".join(self.entries.values())

    def reader(self, name: str) -> Subscriber[Any]:
        return subscriber(self.kind, f"{self.topic}/{name}", 1)

    def writer(self, name: str) -> Publisher[Any]:
        return publisher(self.kind, f"{self.topic}/{name}", 8)

    def onlooker(self, excluded: str) -> Onlooker:
        return Onlooker(f"{self.topic}/{name}" for name in "abcdef" if name not in excluded)

    def passes(self, name: str) -> bool:
        """Return True if a message that ROS sends now arrives in the region."""
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
        for status in array.status:
            self.logged[status.name.partition(": ")[2]] = (
                int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else status.level,
                status.message,
                {value.key: value.value for value in status.values},
            )


@pytest.fixture
def rig(cell: Domain, graph: backend.Graph, schema: Schema, topic: str) -> BridgeRig:
    rig = BridgeRig(cell, graph, schema, topic)
    for name in "abcdef":
        until(lambda name=name: rig.passes(name))
    time.sleep(0.5)  # until the diagnostics are up to date
    return rig


def logged(bridge: Bridge, text: str) -> int:
    return sum(text in line for line in list(bridge.lines))


@pytest.mark.slow
def test_topic_taken_over_by_a_plc_is_reopened_afterwards(rig: BridgeRig) -> None:
    with rig.onlooker("a") as onlooker, a_plc_writes(f"{rig.topic}/a"):
        until(lambda: rig.state("a")[0] == ERROR)
        for _ in range(5):
            rig.outlets["a"].send(rig.outlets["a"].new())
        until(lambda: int(rig.count("a")["missed"]) == 5)
        assert all(rig.passes(name) for name in "bcdef")
        time.sleep(1.5)
        assert (rig.state("a")[0], rig.state("b")[0]) == (ERROR, 0)  # the error stays as long as its cause
        assert "a PLC" in rig.state("a")[1]
    until(lambda: rig.passes("a"))
    until(lambda: rig.state("a")[0] == 0)
    assert max(onlooker.longest.values()) < LONGEST, onlooker.longest
    assert logged(rig.bridge, "has taken the topic over") <= 1
    assert logged(rig.bridge, f"{rig.topic}/a: the region is open again") == 1
    rig.bridge.stop(signal.SIGTERM)


@pytest.mark.slow
def test_region_recreated_by_a_plc_delays_no_other_topic(rig: BridgeRig) -> None:
    """Keep the other heartbeats going while the bridge watches that region for 1.1 s, in case the PLC still runs."""

    def mark_as_plc(words: memoryview) -> None:
        words[h.WRITER], words[h.HEARTBEAT] = h.PLC, 77

    with rig.onlooker("a") as onlooker:
        for _ in range(2):
            made_anew(f"{rig.topic}/a", mark_as_plc)
            until(lambda: rig.passes("a"))
    assert max(onlooker.longest.values()) < LONGEST, onlooker.longest


@pytest.mark.slow
def test_files_that_are_not_regions_delay_no_other_topic(rig: BridgeRig) -> None:
    other_file = file_of(f"{rig.topic}/strange_")
    with rig.onlooker("abcde") as onlooker:
        for name in "abcde":
            other_file.write_bytes(b"x" * 5000)
            other_file.rename(file_of(f"{rig.topic}/{name}"))
        until(lambda: all(rig.state(name)[0] == ERROR for name in "abcde"))
        time.sleep(1.0)
        assert all(rig.state(name)[0] == ERROR and "not a region of shmgen" in rig.state(name)[1] for name in "abcde")
        for name in "abcde":
            file_of(f"{rig.topic}/{name}").unlink()
        until(lambda: all(rig.passes(name) for name in "abcde"))
    assert onlooker.longest[f"{rig.topic}/f"] < LONGEST
    assert logged(rig.bridge, "not a region of shmgen") == 5


@pytest.mark.slow
def test_messages_in_a_removed_region_pass_or_are_counted(rig: BridgeRig) -> None:
    """Count each message that the PLC wrote as passed or missed, also when it recreates its region."""
    written = 0
    for _ in range(10):
        with rig.writer("back") as writer:
            for _ in range(15):
                message = rig.kind()
                message.position.x = written = written + 1
                writer.publish(message)
                time.sleep(0.02)
            file_of(f"{rig.topic}/back").unlink()
        time.sleep(0.05)

    def counted() -> bool:
        count = rig.count("back")
        return int(count["passed"]) + int(count["missed"]) == written and len(rig.back) == int(count["passed"])

    until(counted)
    assert rig.back == sorted(rig.back)


def test_message_is_in_exactly_one_counter(rig: BridgeRig) -> None:
    """Count messages that pass, and messages that arrive while a PLC holds the topic."""
    names = ("passed", "rejected", "missed", "refused", "lost", "rate limited")

    def total() -> int:
        return sum(int(rig.count("a")[name]) for name in names)

    outlet, before = rig.outlets["a"], total()

    def send(count: int) -> None:
        for _ in range(count):
            outlet.send(outlet.new())
            time.sleep(0.002)

    send(50)
    with a_plc_writes(f"{rig.topic}/a"):
        send(100)
    made_anew(f"{rig.topic}/a", lambda words: None)
    send(50)
    until(lambda: total() - before == 200)
    assert int(rig.count("a")["missed"]) > 50


# --- SIGHUP and systemd ---------------------------------------------------------------------------------------


def test_reload_affects_only_changed_topics(rig: BridgeRig, graph: backend.Graph, schema: Schema) -> None:
    before = file_of(f"{rig.topic}/b").stat().st_ino
    passed = int(rig.count("b")["passed"])
    new = ENTRY.format(topic=f"{rig.topic}/new", keys="")
    del rig.entries["a"]
    rig.entries["c"] = ENTRY.format(topic=f"{rig.topic}/c", keys="rate = 5")
    (rig.domain.folder / "shmgen.toml").write_text("# a comment moves all lines\n" + rig.config() + new)
    with rig.onlooker("ac") as onlooker:
        rig.bridge.process.send_signal(signal.SIGHUP)
        rig.bridge.wait_for_line("shmgen.toml was reloaded: topics: 7, services: 0")
        outlet = rig.outlets["new"] = graph.publisher(wire(schema, f"{rig.topic}/new", "geometry_msgs/Pose"))
        until(lambda: rig.passes("new"))
        until(lambda: rig.passes("c"))
        assert rig.passes("b")
        assert not rig.passes("a")
        assert outlet
    assert max(onlooker.longest.values()) < LONGEST, onlooker.longest
    assert file_of(f"{rig.topic}/b").stat().st_ino == before
    until(lambda: int(rig.count("b")["passed"]) > passed)
    with publisher(rig.kind, f"{rig.topic}/a", 1):
        pass  # the bridge has released the claim
    (rig.domain.folder / "shmgen.toml").write_text('[[topics]]\ntopic = "/x"\ntyp = "geometry_msgs/Pose"\n')
    rig.bridge.process.send_signal(signal.SIGHUP)
    rig.bridge.wait_for_line("shmgen.toml was not reloaded: .*typ")
    assert rig.passes("b")
    rig.bridge.stop(signal.SIGTERM)
    assert not logged(rig.bridge, "Traceback")


@pytest.mark.slow
def test_systemd_is_notified_of_ready_watchdog_reload_and_stop(cell: Domain, topic: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address := str(cell.folder / "notify"))
        manager.settimeout(20)
        cell.environment["NOTIFY_SOCKET"] = address
        bridge = cell.bridge(ENTRY.format(topic=topic, keys=""))

        def receive_until(text: str) -> list[str]:
            messages = [manager.recv(4096).decode()]
            while text not in messages[-1]:
                messages.append(manager.recv(4096).decode())
            return messages

        assert receive_until("READY=1") == ["READY=1"]
        receive_until("WATCHDOG=1")
        bridge.process.send_signal(signal.SIGHUP)
        (reloading,) = [line for line in receive_until("READY=1") if "RELOADING" in line]
        assert 0 <= time.monotonic_ns() // 1000 - int(reloading.partition("MONOTONIC_USEC=")[2]) < 20e6
        bridge.stop(signal.SIGTERM)
        receive_until("STOPPING=1")
