"""Our node in the domain: how it joins, how it leaves, and what peers do that it cannot help."""

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

from .conftest import Taken, until, wire


def joined(domain: int | None, logged: list[str], arguments: tuple[str, ...] = ()) -> backend.Graph:
    return backend.connect(Node("shmgen_test", domain, logged.append, lambda: False, arguments, largest=2**20))


@pytest.mark.parametrize("text", ["x", "-1", "233", "1.5"])
def test_no_such_domain(monkeypatch: pytest.MonkeyPatch, logged: list[str], text: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(ValueError, match=f"from 0 to 232, not '{text}' as ROS_DOMAIN_ID says"):
        joined(None, logged)


def test_no_network(monkeypatch: pytest.MonkeyPatch, logged: list[str], domain: int) -> None:
    nowhere = '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="nowhere0"/></Interfaces></General>'
    monkeypatch.setenv("CYCLONEDDS_URI", f"{nowhere}</Domain></CycloneDDS>")
    with pytest.raises(ValueError, match=f"cannot join domain {domain + 100}"):
        joined(domain + 100, logged)
    assert any(line.startswith("dds: Cyclone: nowhere0: ") for line in logged), logged


def test_a_callback_that_raises_is_logged_and_the_next_line_is_read() -> None:
    logged: Queue[str] = Queue()
    dropped, libc = Dropped(logged.put), ctypes.CDLL(None)
    dropped.calls["rt/pose"] = divmod, divmod  # type: ignore[assignment]  # raises TypeError for one argument
    lines = [b"dropping oversize (9 > 8) sample 1 from remote writer 1:2 rt/pose/Pose", b"the next line"]
    with dropped.listens():
        libc.fputs(b"\n".join([*lines, b""]), ctypes.c_void_p.in_dll(libc, "stderr"))
    assert logged.get(timeout=20).startswith("dds: TypeError: ")
    assert logged.get(timeout=20) == "dds: Cyclone: the next line"


def test_domains_are_apart(graph: backend.Graph, domain: int, schema: Schema, topic: str, logged: list[str]) -> None:
    there = wire(schema, topic, "std_msgs/String")
    other = joined(domain % 100 + 1 if domain != 100 else 50, logged)
    came: list[Any] = []
    other.subscribe(there, Taken(came.append))
    outlet = graph.publisher(there)
    for _ in range(5):
        outlet.send(outlet.new())
        time.sleep(0.1)
    other.close()
    assert came == []


def test_leaving_takes_no_time_and_no_thread_stays(
    graph: backend.Graph, schema: Schema, topic: str, logged: list[str]
) -> None:
    there = wire(schema, topic, "std_msgs/String")
    outlet = graph.publisher(there)
    other = joined(None, logged)
    before = threading.active_count()
    came: Queue[Any] = Queue()
    for _ in range(10):
        other.subscribe(there, Taken(came.put))
    until(lambda: outlet.send(outlet.new()) or came.qsize() >= 10)
    assert threading.active_count() == before + 1, "one for all topics"
    begun = time.monotonic()
    other.close()
    assert time.monotonic() - begun < 5
    assert threading.active_count() == before
    outlet.send(outlet.new())  # nobody listens; nobody minds


def test_a_callback_that_waits_does_not_hold_up_the_end(
    graph: backend.Graph, schema: Schema, topic: str, logged: list[str]
) -> None:
    there = wire(schema, topic, "std_msgs/String")
    outlet = graph.publisher(there)
    other = joined(None, logged)
    inside, go = threading.Event(), threading.Event()
    other.subscribe(there, Taken(lambda message: (inside.set(), go.wait(10))))
    until(lambda: outlet.send(outlet.new()) or inside.is_set())
    begun = time.monotonic()
    other.close()
    assert time.monotonic() - begun < 5
    go.set()


def test_what_a_callback_raises_is_told_once(
    graph: backend.Graph, schema: Schema, topic: str, logged: list[str]
) -> None:
    there = wire(schema, topic, "std_msgs/String")
    came: Queue[Any] = Queue()

    def callback(message: Any) -> None:
        came.put(message)
        raise RuntimeError("of ours")

    graph.subscribe(there, Taken(callback))
    outlet = graph.publisher(there)
    until(lambda: outlet.send(outlet.new()) or came.qsize() >= 3)
    assert logged == [f"rt{topic}: RuntimeError: of ours"]


def test_a_peer_with_another_definition(graph: backend.Graph, schema: Schema, topic: str, logged: list[str]) -> None:
    """A subscriber is logged. A message of a publisher is refused, also if Cyclone itself drops it."""
    ours, back = (wire(schema, name, "std_msgs/String") for name in (topic, f"{topic}_back"))
    kind, other = structure(ours.messages), quality(qos.Qos(True, False), 1, f"typehash=RIHS01_{'1' * 64};")
    graph.publisher(back)
    reader = graph._ends.reader(f"rt{topic}_back", kind, other)
    until(lambda: any(line.startswith(f"{topic}_back: a peer has another std_msgs/String") for line in logged), 20)
    sink = Taken(lambda message: None)
    graph.subscribe(ours, sink)
    writer = graph._ends.writer(f"rt{topic}", kind, other)
    until(lambda: sink.logged, 20)  # the incompatible peer is reported when it matches
    # Cyclone's own writers send no bytes that Cyclone drops, so call what runs when it logs such a message.
    graph._dropped.calls[f"rt{topic}"][1]("too short")
    assert "its type hash is RIHS01_1111" in sink.logged[-1]
    del reader, writer


def test_text_that_is_no_utf8(graph: backend.Graph, domain: int, schema: Schema, topic: str, logged: list[str]) -> None:
    """As a Latin-1 peer sends it: logged, and the next message passes."""
    came: Queue[Any] = Queue()
    graph.subscribe(wire(schema, topic, "std_msgs/String"), Taken(came.put, logged))
    kind: Any = make_idl_struct("String", "std_msgs::msg::dds_::String_", {"data_": str})
    participant = DomainParticipant(domain)
    reliable = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(10))
    writer = DataWriter(participant, Topic(participant, f"rt{topic}", kind), reliable)
    kind.serialize = lambda self, **_: bytes.fromhex("00010000 02000000") + self.data_.encode("latin-1") + b"\0"
    until(writer.get_matched_subscriptions)
    for text in "üa":
        writer.write(kind(text))
    assert came.get(timeout=5).data == "a"
    assert logged[0] == f"{topic}: a peer announces no type hash; its std_msgs/String is assumed to be the same"
    assert "Could not deserialize 'std_msgs/msg/String'" in logged[1]


def test_what_two_peers_say_at_once_is_not_mixed(
    graph: backend.Graph, schema: Schema, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cyclone's Python has one place for what any peer says: a good client was taken for a stranger, its call lost."""
    ends, kind = graph._ends, structure(wire(schema, topic, "std_msgs/String").messages)
    qualities = [quality(qos.Qos(True, False), 1, f"who={number};") for number in range(2)]
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
        said = threads.map(lambda reader: user_data_of(reader, *matches(reader)), readers)
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
        remember_bounded(known, handle, "")
    assert list(known) == list(range(4000, 5000))
