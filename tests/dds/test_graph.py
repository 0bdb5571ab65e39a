"""Test the bridge's DDS node: how it joins and leaves a domain, and how it handles incompatible peers."""

from __future__ import annotations

import ctypes
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

from shmgen.bridge.backend import Node
from shmgen.bridge.common import qos
from shmgen.bridge.common.support import remember_bounded
from shmgen.bridge.dds import backend
from shmgen.bridge.dds.dropped import Dropped
from shmgen.bridge.dds.entities import matches, quality, user_data_of
from shmgen.bridge.dds.types import structure
from shmgen.core.model import Schema

from .conftest import Errors, until, wire


def connect_graph(domain: int | None, logged: list[str], arguments: tuple[str, ...] = ()) -> backend.Graph:
    return backend.connect(Node("shmgen_test", domain, logged.append, lambda: False, arguments, largest=2**20))


@pytest.mark.parametrize("text", ["x", "-1", "233", "1.5"])
def test_invalid_domain_is_rejected(monkeypatch: pytest.MonkeyPatch, logged: list[str], text: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(ValueError, match=f"from 0 to 232, not '{text}'"):
        connect_graph(None, logged)


def test_missing_network_interface_is_reported(monkeypatch: pytest.MonkeyPatch, logged: list[str], domain: int) -> None:
    nowhere = '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="nowhere0"/></Interfaces></General>'
    monkeypatch.setenv("CYCLONEDDS_URI", f"{nowhere}</Domain></CycloneDDS>")
    with pytest.raises(ValueError, match=f"cannot join domain {domain + 100}"):
        connect_graph(domain + 100, logged)
    assert any(line.startswith("dds: Cyclone: nowhere0: ") for line in logged), logged


def test_error_of_a_callback_is_logged_and_the_next_line_is_read() -> None:
    logged: Queue[str] = Queue()
    dropped, libc = Dropped(logged.put), ctypes.CDLL(None)
    dropped.calls["rt/pose"] = divmod, divmod  # type: ignore[assignment]  # raises TypeError for one argument
    lines = [b"dropping oversize (9 > 8) sample 1 from remote writer 1:2 rt/pose/Pose", b"the next line"]
    with dropped.listens():
        libc.fputs(b"\n".join([*lines, b""]), ctypes.c_void_p.in_dll(libc, "stderr"))
    assert logged.get(timeout=20).startswith("dds: TypeError: ")
    assert logged.get(timeout=20) == "dds: Cyclone: the next line"


def test_domains_are_separate(graph: backend.Graph, domain: int, schema: Schema, topic: str, logged: list[str]) -> None:
    string_wire = wire(schema, topic, "std_msgs/String")
    other = connect_graph(domain % 100 + 1 if domain != 100 else 50, logged)
    received: list[Any] = []
    other.subscribe(string_wire, received.append, Errors())
    outlet = graph.publisher(string_wire)
    for _ in range(5):
        outlet.send(outlet.new())
        time.sleep(0.1)
    other.close()
    assert received == []


def test_close_is_prompt_and_leaves_no_thread(
    graph: backend.Graph, schema: Schema, topic: str, logged: list[str]
) -> None:
    string_wire = wire(schema, topic, "std_msgs/String")
    outlet = graph.publisher(string_wire)
    other = connect_graph(None, logged)
    before = threading.active_count()
    received: Queue[Any] = Queue()
    for _ in range(10):
        other.subscribe(string_wire, received.put, Errors())
    until(lambda: outlet.send(outlet.new()) or received.qsize() >= 10)
    assert threading.active_count() == before + 1, "one thread for all topics"
    started_at = time.monotonic()
    other.close()
    assert time.monotonic() - started_at < 5
    assert threading.active_count() == before
    outlet.send(outlet.new())  # sending without a subscriber raises nothing


def test_blocked_callback_does_not_delay_close(
    graph: backend.Graph, schema: Schema, topic: str, logged: list[str]
) -> None:
    string_wire = wire(schema, topic, "std_msgs/String")
    outlet = graph.publisher(string_wire)
    other = connect_graph(None, logged)
    inside, go = threading.Event(), threading.Event()
    other.subscribe(string_wire, lambda message: (inside.set(), go.wait(10)), Errors())
    until(lambda: outlet.send(outlet.new()) or inside.is_set())
    started_at = time.monotonic()
    other.close()
    assert time.monotonic() - started_at < 5
    go.set()


def test_repeated_error_of_a_callback_is_logged_once(
    graph: backend.Graph, schema: Schema, topic: str, logged: list[str]
) -> None:
    string_wire = wire(schema, topic, "std_msgs/String")
    received: Queue[Any] = Queue()

    def callback(message: Any) -> None:
        received.put(message)
        raise RuntimeError("of ours")

    graph.subscribe(string_wire, callback, Errors())
    outlet = graph.publisher(string_wire)
    until(lambda: outlet.send(outlet.new()) or received.qsize() >= 3)
    assert logged == [f"rt{topic}: RuntimeError: of ours"]


def test_another_definition_is_refused(graph: backend.Graph, schema: Schema, topic: str, logged: list[str]) -> None:
    """Log a subscriber. Refuse a publisher's message, also if Cyclone itself drops it."""
    ours, back_wire = (wire(schema, name, "std_msgs/String") for name in (topic, f"{topic}_back"))
    kind, other = structure(ours.messages), quality(qos.Qos(True, False), 1, f"typehash=RIHS01_{'1' * 64};")
    graph.publisher(back_wire)
    reader = graph._ends.reader(f"rt{topic}_back", kind, other)
    until(lambda: any(f"{topic}_back: a peer uses another definition of std_" in line for line in logged), 20)
    errors = Errors()
    graph.subscribe(ours, lambda message: None, errors)
    writer = graph._ends.writer(f"rt{topic}", kind, other)
    until(lambda: errors.logged, 20)  # the incompatible peer is reported when it matches
    # Cyclone's own writers send no bytes that Cyclone drops, so call what runs when it logs such a message.
    graph._dropped.calls[f"rt{topic}"][1]("too short")
    assert "its type hash is RIHS01_1111" in errors.logged[-1]
    del reader, writer


def test_non_utf8_is_logged(graph: backend.Graph, domain: int, schema: Schema, topic: str, logged: list[str]) -> None:
    """Log Latin-1 text of a peer, and pass the next message."""
    received: Queue[Any] = Queue()
    graph.subscribe(wire(schema, topic, "std_msgs/String"), received.put, Errors(logged))
    kind: Any = make_idl_struct("String", "std_msgs::msg::dds_::String_", {"data_": str})
    participant = DomainParticipant(domain)
    reliable = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(10))
    writer = DataWriter(participant, Topic(participant, f"rt{topic}", kind), reliable)
    kind.serialize = lambda self, **_: bytes.fromhex("00010000 02000000") + self.data_.encode("latin-1") + b"\0"
    until(writer.get_matched_subscriptions)
    for text in "üa":
        writer.write(kind(text))
    assert received.get(timeout=5).data == "a"
    assert logged[0] == f"{topic}: a peer announces no type hash; its std_msgs/String is assumed to be the same"
    assert "Could not deserialize 'std_msgs/msg/String'" in logged[1]


def test_user_data_of_two_peers_is_not_mixed(
    graph: backend.Graph, schema: Schema, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Keep the user data of two peers apart, although Cyclone's Python shares one buffer between all reads."""
    ends, kind = graph._ends, structure(wire(schema, topic, "std_msgs/String").messages)
    qualities = [quality(qos.Qos(True, False), 1, f"who={number};") for number in range(2)]
    writers = [ends.writer(f"rt{topic}{number}", kind, qos) for number, qos in enumerate(qualities)]
    readers = [ends.reader(writer.topic.name, kind, qos) for writer, qos in zip(writers, qualities, strict=True)]
    until(lambda: all(matches(reader) for reader in readers))
    read, both = _CQos._get_userdata, threading.Barrier(2)

    def read_slowly(*arguments: Any) -> Any:
        result = read(*arguments)
        with suppress(threading.BrokenBarrierError):  # the other thread waits until this call is done
            both.wait(0.2)
        return result

    monkeypatch.setattr(_CQos, "_get_userdata", read_slowly)
    with ThreadPoolExecutor() as threads:
        user_data = threads.map(lambda reader: user_data_of(reader, *matches(reader)), readers)
        assert [items[0] for items in user_data] == ["who=0", "who=1"]


def test_queue_overflow_is_reported(graph: backend.Graph, schema: Schema, topic: str) -> None:
    """Report an overflow as one loss, because Cyclone does not count the samples that its history overwrote."""
    string_wire = wire(schema, topic, "std_msgs/String")
    inside, go, received = threading.Event(), threading.Event(), []

    def callback(message: Any) -> None:
        received.append(message)
        inside.set()
        go.wait(60)

    errors = Errors()
    graph.subscribe(string_wire, callback, errors)
    outlet = graph.publisher(string_wire)
    message = outlet.new()
    until(lambda: outlet.send(message) or inside.is_set())
    for _ in range(string_wire.queue + 10):
        outlet.send(message)
    assert not errors.lost
    go.set()
    until(lambda: len(received) > string_wire.queue, 20)
    assert errors.lost == 1
    outlet.send(message)
    until(lambda: len(received) > string_wire.queue + 1, 20)
    assert errors.lost == 1


def test_oldest_peers_are_forgotten() -> None:
    """Bound the memory of a bridge that runs for years: each `ros2 service call` is a new client."""
    known: dict[int, str] = {}
    for handle in range(5000):
        remember_bounded(known, handle, "")
    assert list(known) == list(range(4000, 5000))
