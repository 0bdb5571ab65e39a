"""Our node in the domain: how it joins, how it leaves, and what peers do that it cannot help."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from queue import Queue
from typing import Any

import pytest
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos, _CQos
from cyclonedds.topic import Topic

from shmgen.bridge.backend import Node, keep
from shmgen.bridge.dds import backend
from shmgen.bridge.dds.entities import matches, quality, said_by
from shmgen.bridge.dds.types import structure
from shmgen.core.model import Schema

from .conftest import Taken, until, wire


def joined(domain: int | None, told: list[str], arguments: tuple[str, ...] = ()) -> backend.Graph:
    return backend.connect(Node("shmgen_test", domain, told.append, lambda: False, arguments, largest=2**20))


@pytest.mark.parametrize("text", ["x", "-1", "233", "1.5"])
def test_no_such_domain(monkeypatch: pytest.MonkeyPatch, told: list[str], text: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(ValueError, match=f"from 0 to 232, not '{text}' as ROS_DOMAIN_ID says"):
        joined(None, told)


def test_no_network(monkeypatch: pytest.MonkeyPatch, told: list[str], domain: int) -> None:
    nowhere = '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="nowhere0"/></Interfaces></General>'
    monkeypatch.setenv("CYCLONEDDS_URI", f"{nowhere}</Domain></CycloneDDS>")
    with pytest.raises(ValueError, match=f"cannot join domain {domain + 100}"):
        joined(domain + 100, told)
    assert any(line.startswith("dds: Cyclone says: nowhere0: ") for line in told), told


def test_what_is_not_looked_at_is_told(told: list[str]) -> None:
    joined(None, told, ("--ros-args", "-r", "__node:=x")).close()
    assert told == ["dds: there is no ROS here to take --ros-args -r __node:=x"]


def test_domains_are_apart(graph: backend.Graph, domain: int, schema: Schema, topic: str, told: list[str]) -> None:
    there = wire(schema, topic, "std_msgs/String")
    other = joined(domain % 100 + 1 if domain != 100 else 50, told)
    came: list[Any] = []
    other.subscribe(there, Taken(came.append))
    outlet = graph.publisher(there)
    for _ in range(5):
        outlet.send(outlet.new())
        time.sleep(0.1)
    other.close()
    assert came == []


def test_leaving_takes_no_time_and_no_thread_stays(
    graph: backend.Graph, schema: Schema, topic: str, told: list[str]
) -> None:
    there = wire(schema, topic, "std_msgs/String")
    outlet = graph.publisher(there)
    other = joined(None, told)
    before = threading.active_count()
    came: Queue[Any] = Queue()
    for _ in range(10):
        other.subscribe(there, Taken(came.put))
    until(lambda: outlet.send(outlet.new()) or came.qsize() >= 10)
    assert threading.active_count() == before + 1, "one for all topics"
    begun = time.monotonic()
    other.close()
    assert time.monotonic() - begun < 0.5
    assert threading.active_count() == before
    outlet.send(outlet.new())  # nobody listens; nobody minds


def test_a_callback_that_waits_does_not_hold_up_the_end(
    graph: backend.Graph, schema: Schema, topic: str, told: list[str]
) -> None:
    there = wire(schema, topic, "std_msgs/String")
    outlet = graph.publisher(there)
    other = joined(None, told)
    inside, go = threading.Event(), threading.Event()
    other.subscribe(there, Taken(lambda message: (inside.set(), go.wait(10))))
    until(lambda: outlet.send(outlet.new()) or inside.is_set())
    begun = time.monotonic()
    other.close()
    assert time.monotonic() - begun < 0.6
    go.set()


def test_what_a_callback_raises_is_told_once(graph: backend.Graph, schema: Schema, topic: str, told: list[str]) -> None:
    there = wire(schema, topic, "std_msgs/String")
    came: Queue[Any] = Queue()

    def callback(message: Any) -> None:
        came.put(message)
        raise RuntimeError("of ours")

    graph.subscribe(there, Taken(callback))
    outlet = graph.publisher(there)
    until(lambda: outlet.send(outlet.new()) or came.qsize() >= 3)
    assert told == [f"rt{topic}: RuntimeError: of ours"]


def test_text_that_is_no_utf8(graph: backend.Graph, domain: int, schema: Schema, topic: str, told: list[str]) -> None:
    """As a Latin-1 peer sends it: told, and the next message passes."""
    came: Queue[Any] = Queue()
    graph.subscribe(wire(schema, topic, "std_msgs/String"), Taken(came.put, told))
    kind: Any = make_idl_struct("String", "std_msgs::msg::dds_::String_", {"data_": str})
    participant = DomainParticipant(domain)
    reliable = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(10))
    writer = DataWriter(participant, Topic(participant, f"rt{topic}", kind), reliable)
    kind.serialize = lambda self, **_: bytes.fromhex("00010000 02000000") + self.data_.encode("latin-1") + b"\0"
    until(writer.get_matched_subscriptions)
    for text in "üa":
        writer.write(kind(text))
    assert came.get(timeout=5).data == "a"
    assert told[0] == f"{topic}: a peer announces no type hash; its std_msgs/String is assumed to be the same"
    assert "Could not deserialize 'std_msgs/msg/String'" in told[1]


def test_what_two_peers_say_at_once_is_not_mixed(
    graph: backend.Graph, schema: Schema, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cyclone's Python has one place for what any peer says: a good client was taken for a stranger, its call lost."""
    ends, kind = graph._ends, structure(wire(schema, topic, "std_msgs/String").messages)
    qualities = [quality("reliable", False, 1, f"who={number};") for number in range(2)]
    writers = [ends.writer(f"rt{topic}{number}", kind, qos) for number, qos in enumerate(qualities)]
    readers = [ends.reader(writer.topic.name, kind, qos) for writer, qos in zip(writers, qualities, strict=True)]
    until(lambda: all(matches(reader) for reader in readers))
    read, both = _CQos._get_userdata, threading.Barrier(2)

    def slowly(*words: Any) -> Any:
        found = read(*words)
        with suppress(threading.BrokenBarrierError):  # the other one waits until we are done
            both.wait(0.2)
        return found

    monkeypatch.setattr(_CQos, "_get_userdata", slowly)
    with ThreadPoolExecutor() as threads:
        said = threads.map(lambda reader: said_by(reader, *matches(reader)), readers)
        assert [words[0] for words in said] == ["who=0", "who=1"]


def test_a_queue_that_ran_over_is_told(graph: backend.Graph, schema: Schema, topic: str) -> None:
    """Cyclone does not say what its history has overwritten, nor how much."""
    there = wire(schema, topic, "std_msgs/String")
    inside, go, came = threading.Event(), threading.Event(), []

    def callback(message: Any) -> None:
        came.append(message)
        inside.set()
        go.wait(60)

    sink = Taken(callback)
    graph.subscribe(there, sink)
    outlet = graph.publisher(there)
    message = outlet.new()
    until(lambda: outlet.send(message) or inside.is_set())
    for _ in range(there.queue + 10):
        outlet.send(message)
    assert not sink.lost
    go.set()
    until(lambda: len(came) > there.queue, 20)
    assert sink.lost == 1
    outlet.send(message)
    until(lambda: len(came) > there.queue + 1, 20)
    assert sink.lost == 1


def test_who_came_and_went_is_forgotten() -> None:
    """A bridge runs for years, and each `ros2 service call` is one more client."""
    known: dict[int, str] = {}
    for handle in range(5000):
        keep(known, handle, "")
    assert list(known) == list(range(4000, 5000))
