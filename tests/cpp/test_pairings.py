"""C, C++, Python and Structured Text exchange samples on one topic, in every pairing that contains C or C++."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

import pytest

from shmgen.runtime import region_name

from ..support.cpp_peer import Peer
from ..support.machine import slower
from ..support.plc_demo import CONFIRM, Clock, Demo, Memory, semaphore
from .conftest import SANITIZE

Start = Callable[..., Peer]
Sample = tuple[int, int, str, list[int]]


class Writer(Protocol):
    def open(self, topic: str, depth: int) -> None: ...
    def write(self, a: int) -> None: ...


class Reader(Protocol):
    def open(self, topic: str, depth: int) -> None: ...
    def newest(self) -> Sample | None: ...
    def all(self) -> list[int]: ...

    @property
    def missed(self) -> int: ...


class PeerEnd:
    """A publisher or subscriber in C or C++."""

    def __init__(self, peer: Peer, role: str) -> None:
        self.peer, self.role = peer, role

    def open(self, topic: str, depth: int) -> None:
        assert self.peer.opens("x", self.role, topic, f"depth={depth}") == 0

    def write(self, a: int) -> None:
        assert self.peer.does(f"publish x {a}") == 0

    def newest(self) -> Sample | None:
        values = self.peer.reads("read x")
        return values and (int(values[0]), int(values[1]), values[2], list(map(int, values[3:])))

    def all(self) -> list[int]:
        return list(map(int, self.peer.ask("all x").split()[1:]))

    @property
    def missed(self) -> int:
        return int(self.peer.ask("figures x").split()[1])

    def cycle(self, a: int) -> Sample | None:
        """Run one cycle of a control loop. In C, call the step function first."""
        if self.peer.language == "c" and self.peer.does("step x") != 0:
            return None
        if self.role == "sub":
            values = self.peer.ask("read x").split()
            return (int(values[1]), int(values[2]), values[3], list(map(int, values[4:]))) if values[0] == "0" else None
        self.peer.does(f"publish x {a}")
        return None


class PythonEnd:
    def __init__(self, demo: Demo, role: str, stack: ExitStack) -> None:
        self.demo, self.stack = demo, stack
        self.kind = demo.python.DemoPublisher if role == "pub" else demo.python.DemoSubscriber

    def open(self, topic: str, depth: int) -> None:
        self.end = self.stack.enter_context(self.kind(topic, depth=depth))

    def write(self, a: int) -> None:
        self.end.publish(self.demo.message(a))

    def newest(self) -> Sample | None:
        sample = self.end.read()
        return sample and (sample.a, sample.b, sample.label, list(sample.tail))

    def cycle(self, a: int) -> Sample | None:
        if hasattr(self.end, "read"):
            return self.newest()
        self.write(a)
        return None

    def all(self) -> list[int]:
        return [sample.a for sample in self.end.read_all()]

    @property
    def missed(self) -> int:
        return int(self.end.missed)


class PlcEnd:
    def __init__(self, demo: Demo, clock: Clock, role: str) -> None:
        self.demo, self.clock, self.role = demo, clock, role

    def open(self, topic: str, depth: int) -> None:
        if self.role == "pub":
            self.block: Any = self.demo.publisher(topic, udiDepth=depth)
            for ms in (0, CONFIRM):
                self.clock.add(ms)
                for _ in range(3):  # open the region, reopen it if it was replaced, and claim it
                    self.block(xSend=False)
        else:
            self.block = self.demo.subscriber(topic, udiDepth=depth)
            self.block()

    def write(self, a: int) -> None:
        message = self.block.Msg
        message.a, message.b, message.label = a, 2 * a, f"x{a % 1000}"
        message.tail_count, message.tail[0], message.tail[1] = 2, a, -a
        assert self.block(xSend=True).xSent

    def newest(self) -> Sample | None:
        self.block(xNewest=True)
        message = self.block.Msg
        tail = list(message.tail)[: message.tail_count]
        return (message.a, message.b, message.label, tail) if self.block.xNewData else None

    def cycle(self, a: int) -> Sample | None:
        self.clock.add(10)
        if self.role == "sub":
            return self.newest()
        message = self.block.Msg
        message.a, message.b, message.label = a, 2 * a, f"x{a % 1000}"
        message.tail_count, message.tail[0], message.tail[1] = 2, a, -a
        self.block(xSend=True)
        return None

    def all(self) -> list[int]:
        values = []
        while self.block(xNewest=False).xNewData:
            values.append(self.block.Msg.a)
        return values

    @property
    def missed(self) -> int:
        return int(self.block.udiMissed)


LANGUAGES = ("c", "cpp", "python", "plc")
PAIRS = [pair for pair in itertools.product(LANGUAGES, LANGUAGES) if {"c", "cpp"} & set(pair)]


@pytest.mark.parametrize("first", ["pub", "sub"])
@pytest.mark.parametrize(("writer", "reader"), PAIRS)
def test_samples_arrive_in_every_pairing(
    writer: str, reader: str, first: str, peer: Start, demo: Demo, clock: Clock, topic: str
) -> None:
    """Read single samples and bursts, within and beyond the depth of 4. Either end opens first."""
    with ExitStack() as stack:

        def create_end(language: str, role: str) -> Any:
            if language == "python":
                return PythonEnd(demo, role, stack)
            return PlcEnd(demo, clock, role) if language == "plc" else PeerEnd(peer(language), role)

        write, read = create_end(writer, "pub"), create_end(reader, "sub")
        for end in (write, read) if first == "pub" else (read, write):
            end.open(topic, 4)
        assert read.newest() is None
        for a in (1, 2):
            write.write(a)
            assert read.newest() == (a, 2 * a, f"x{a}", [a, -a])
            assert read.newest() is None
        for a in range(3, 7):
            write.write(a)
        assert (read.all(), read.missed) == ([3, 4, 5, 6], 0)
        for a in range(7, 27):
            write.write(a)
        values = read.all()
        assert values == list(range(27 - len(values), 27))
        assert len(values) >= 4
        assert len(values) + read.missed == 20
        for a in (27, 28):
            write.write(a)
        missed = read.missed
        assert (read.newest(), read.missed) == ((28, 56, "x28", [28, -28]), missed + 1)
    assert semaphore(topic).value == 1


@pytest.mark.parametrize(("writer", "reader"), [*itertools.product(LANGUAGES, LANGUAGES)])
def test_samples_resume_after_rm(writer: str, reader: str, peer: Start, demo: Demo, clock: Clock, topic: str) -> None:
    """Reopen the region within a second in loops of 100 Hz. Two PLC endpoints keep using the removed region."""
    region = Path("/dev/shm") / region_name(topic)
    with ExitStack() as stack:

        def create_end(language: str, role: str) -> Any:
            if language == "python":
                return PythonEnd(demo, role, stack)
            return PlcEnd(demo, clock, role) if language == "plc" else PeerEnd(peer(language), role)

        write, read = create_end(writer, "pub"), create_end(reader, "sub")
        for end in (write, read):
            end.open(topic, 4)
        for removal in range(2):
            before = region.stat().st_ino
            region.unlink()
            deadline, sample, a = time.monotonic() + slower, None, 1000 * removal
            while time.monotonic() < deadline:
                is_recreated = region.exists() and region.stat().st_ino != before
                a += 1
                write.cycle(a)
                sample = read.cycle(a)
                if sample and (is_recreated or {writer, reader} == {"plc"}):
                    break
                time.sleep(0.01)
            assert sample == (a, 2 * a, f"x{a % 1000}", [a, -a])
            if {writer, reader} == {"plc"}:
                break


@pytest.mark.parametrize(("writer", "reader"), [pair for pair in PAIRS if "plc" not in pair])
def test_sample_numbers_wrap(writer: str, reader: str, peer: Start, demo: Demo, clock: Clock, topic: str) -> None:
    """Wrap from 16#FFFFFFFF to the number of slots, here 8, without losing or miscounting a sample."""
    with ExitStack() as stack:

        def create_end(language: str, role: str) -> Any:
            return PythonEnd(demo, role, stack) if language == "python" else PeerEnd(peer(language), role)

        former_writer = PeerEnd(peer("c"), "pub")
        former_writer.open(topic, 4)
        former_writer.write(1)
        memory = Memory(topic)
        memory["completed0"] = 2**32 - 3
        former_writer.peer.kill()
        write, read = create_end(writer, "pub"), create_end(reader, "sub")
        write.open(topic, 4)
        read.open(topic, 4)
        for a in range(2, 5):
            write.write(a)
        assert (read.all(), memory["completed0"]) == ([2, 3, 4], 8)
        for a in range(5, 11):
            write.write(a)
        assert (read.newest(), memory["completed0"], read.missed) == ((10, 20, "x10", [10, -10]), 14, 5 + 1)


def test_oversized_value_is_refused_and_its_field_named(language: str, peer: Start, demo: Demo, topic: str) -> None:
    """Keep the former sample in the region. Refuse to read a sample whose count exceeds its bound."""
    process = peer(language)
    assert (process.opens("w", "pub", topic), process.opens("r", "sub", topic)) == (0, 0)
    assert process.does("publish w 1") == 0
    before = Memory(topic).bytes()
    assert process.ask("misfit w count") == "52 tail 1"
    assert process.ask("misfit w text") == "53 label 2"
    if language == "cpp":
        assert process.ask("misfit w nul") == "53 label 3"
    assert Memory(topic).bytes() == before
    assert process.reads("read r") == ["1", "2", "x1", "1", "-1"]
    damaged = demo.message(2)
    damaged._tail_count = 4
    process.does("close w")
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(damaged)
        assert process.ask("read r").split()[0] == "52"
        assert process.ask("figures r").split()[3:] == ["1", "stamped", "tail"]
        publisher.publish(demo.message(3))
        assert process.reads("read r") == ["3", "6", "x3", "3", "-3"]
        unterminated = demo.message(4)
        number = publisher.sequence + 1
        publisher.publish(unterminated)
        slot = 192 + number % 2 * 128
        memory = Memory(topic)
        label = memory.bytes()[slot:].index(b"x4\0")
        memory.poke(slot + label, b"y" * 10)
        assert process.reads("read r") == ["4", "8", "y" * 9, "4", "-4"]


@pytest.mark.skipif(bool(SANITIZE), reason="sanitizers make system calls")
def test_cyclic_calls_make_no_system_call(language: str, peer: Start, topic: str) -> None:
    """Run in seccomp's strict mode, in which almost every system call ends the process with SIGKILL."""
    process = peer(language)
    assert (process.opens("w", "pub", topic, "unstamped=1"), process.opens("r", "sub", topic)) == (0, 0)
    assert process.ask("strict w") == "0"
    assert process.process.wait(10) == 0


def test_waiting_reader_is_woken_by_a_sample(language: str, peer: Start, demo: Demo, topic: str) -> None:
    reader = peer(language)
    assert reader.opens("r", "sub", topic) == 0
    assert reader.does("wait r 10") == 100
    with demo.python.DemoPublisher(topic) as publisher:
        reader.tell("wait r 20000")
        while not Memory(topic)["armed"]:
            pass
        publisher.publish(demo.message(1))
        assert reader.hear().split()[:2] == ["0", "1"]
    writer = peer(language)
    assert writer.opens("w", "pub", topic) == 0
    with demo.python.DemoSubscriber(topic) as subscriber:
        subscriber.read()
        writer.tell("sleep 30")
        writer.tell("publish w 2")
        assert subscriber.wait(20).a == 2
        assert subscriber.age is not None
    assert [writer.hear().split()[0] for _ in range(2)] == ["0", "0"]


def test_silent_writer_is_stale_until_its_heartbeat(language: str, peer: Start, topic: str) -> None:
    process = peer(language)
    assert (process.opens("w", "pub", topic), process.opens("r", "sub", topic)) == (0, 0)
    assert process.ask("stale r 1000") == "0"
    process.does("sleep 20")
    assert process.ask("stale r 20") == "1"
    assert process.does("heartbeat w") == 0
    assert process.ask("stale r 20") == "0"


def test_sequence_region_works_without_a_lock(peer: Start, demo: Demo, topic: str) -> None:
    process = peer("c")
    assert process.opens("w", "pub", topic, "sequence=1", "depth=4") == 0
    assert process.opens("r", "sub", topic, "sequence=1", "depth=4") == 0
    for a in range(1, 4):
        assert process.does(f"publish w {a}") == 0
    assert process.ask("all r") == "0 1 2 3"
    assert process.does("wait r 5") == 100
    assert not list(Path("/dev/shm").glob(f"sem.*{topic.rpartition('/')[2]}*"))
