"""The rules of docs/protocol.md, kept by C and C++: what is refused, who may write, and what a dead process leaves."""

from __future__ import annotations

import grp
import os
import signal
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from shmgen.runtime import ClaimLost, LayoutMismatch, RegionInUse, region_name
from shmgen.runtime.region.record_locks import WRITER_LOCK, lock_byte

from ..support.cpp_peer import Peer
from ..support.plc_demo import CLAIM, CONFIRM, SLOTS, Clock, Demo, Memory, semaphore

Start = Callable[..., Peer]

DIGEST, DEPTH, SIZE, NO_REGION, ABI, PAYLOAD = 22, 24, 12, 20, 21, 23
STRANGER, SEMAPHORE, OPEN_FAILED, IN_USE, LOST, OPENING, NOTHING = 16, 31, 13, 40, 41, 102, 100


def file_of(topic: str) -> Path:
    return Path("/dev/shm") / region_name(topic)


def semaphore_of(topic: str) -> Path:
    return Path("/dev/shm") / f"sem.{region_name(topic)}"


@contextmanager
def writes(topic: str) -> Iterator[None]:
    """Somebody does, whose region nobody replaces."""
    with file_of(topic).open("r+b") as held:
        assert lock_byte(held.fileno(), WRITER_LOCK)
        yield


# --- what is there already --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("topic_name", "status"),
    [
        ("", 1),
        ("/", 1),
        ("a//b", 2),
        ("/1a", 2),
        ("/a-b", 2),
        ("/a/", 2),
        ("~a", 2),
        ("/sem/a", 2),
        ("/CME", 2),
        ("/RetainMemory", 2),
        ("/gwdrvsharedmemshm-goal", 2),
        ("/" + "a" * 246, 3),
    ],
)
def test_a_topic_that_is_none(topic_name: str, status: int, peer: Start) -> None:
    process = peer("c")
    if topic_name:
        assert process.opens("x", "sub", topic_name) == status
    assert process.opens("x", "sub", "/a", "depth=65536") == 4
    assert process.opens("x", "sub", "/a", "lock_us=1000001") == 6
    assert process.opens("x", "sub", "/a", "group=no_such_group") == 7
    assert not file_of("/a").exists()


def test_another_layout_or_depth(language: str, peer: Start, demo: Demo, topic: str) -> None:
    process = peer(language)
    with demo.python.OtherSubscriber(topic):
        assert process.opens("x", "sub", topic) == DIGEST
    with demo.python.DemoPublisher(f"{topic}/deep", depth=4):
        assert process.opens("x", "pub", f"{topic}/deep") == DEPTH
    assert process.opens("x", "pub", f"{topic}/deep", "depth=4") == 0
    assert process.opens("y", "sub", f"{topic}/ours") == 0
    with pytest.raises(LayoutMismatch):
        demo.python.OtherSubscriber(f"{topic}/ours")
    with pytest.raises(LayoutMismatch):
        demo.python.DemoSubscriber(f"{topic}/ours", depth=4)


def test_the_header_is_pythons(language: str, peer: Start, demo: Demo, topic: str) -> None:
    assert peer(language).opens("x", "sub", topic) == 0
    with demo.python.DemoSubscriber(f"{topic}/python"):
        assert Memory(topic).bytes() == Memory(f"{topic}/python").bytes()


WORDS = {0: NO_REGION, 4: ABI, 6: ABI, 8: DIGEST, 16: PAYLOAD, 20: PAYLOAD, 28: DEPTH, 33: DIGEST}
"""By the offset of a damaged byte, the status."""


def test_each_word_that_the_maker_writes_is_looked_at(language: str, peer: Start, topic: str) -> None:
    process = peer(language)
    assert process.opens("x", "sub", topic) == 0
    data = file_of(topic).read_bytes()
    with writes(topic):
        for offset, status in WORDS.items():
            file_of(topic).write_bytes(data[:offset] + bytes([data[offset] ^ 0x41]) + data[offset + 1 :])
            assert (offset, process.opens("y", "sub", topic)) == (offset, status)
            assert process.opens("y", "pub", topic) == status
        for size in (192, len(data) + 4096):
            file_of(topic).write_bytes(data.ljust(size, b"\0")[:size])
            assert process.opens("y", "sub", topic) == SIZE
    file_of(topic).write_bytes(b"\0" * 4096)  # made by one who died before his header
    assert process.opens("y", "sub", topic) == 0
    assert file_of(topic).read_bytes()[:32] == data[:32]
    file_of(topic).write_bytes(b"")  # and before its size
    assert process.opens("y", "sub", topic) == 0


def test_a_region_that_a_runtime_has_rounded_up_to_larger_pages(language: str, peer: Start, topic: str) -> None:
    """As on a Raspberry Pi 5; but not where something lies in the rest, or where it is no such rounding."""
    process = peer(language)
    assert process.opens("made", "pub", topic) == 0
    data = file_of(topic).read_bytes()
    process.does("close made")
    for page in (16384, 65536):
        for there in (data, b""):  # made, and still being made
            file_of(topic).write_bytes(there.ljust(page, b"\0"))
            assert (process.opens("w", "pub", topic), process.opens("r", "sub", topic)) == (0, 0)
            assert process.does(f"publish w {page}") == 0
            found = process.reads("read r")
            assert found
            assert (found[0], file_of(topic).stat().st_size) == (str(page), page)
            process.does("close w"), process.does("close r")
        with writes(topic):
            for at in (len(data), page - 1):
                file_of(topic).write_bytes(data.ljust(at, b"\0") + b"1".ljust(page - at, b"\0"))
                assert (at, process.opens("x", "sub", topic)) == (at, SIZE)
    with writes(topic):
        for size in (8192, 3 * 16384):
            file_of(topic).write_bytes(data.ljust(size, b"\0"))
            assert (size, process.opens("x", "sub", topic)) == (size, SIZE)


def test_what_is_no_file_of_ours(language: str, peer: Start, topic: str, tmp_path: Path) -> None:
    process = peer(language)
    file_of(topic).symlink_to(tmp_path / "x")
    assert process.opens("x", "sub", topic) == OPEN_FAILED
    file_of(topic).unlink()
    os.mkfifo(file_of(topic))
    assert process.opens("x", "sub", topic) == OPEN_FAILED
    file_of(topic).unlink()
    for data in (b"", b"\0" * 31, struct.pack("8xI20x", 7)):
        semaphore_of(topic).write_bytes(data)
        semaphore_of(topic).chmod(0o660)
        assert process.opens("x", "sub", topic) == SEMAPHORE


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_whose_files_are_used(language: str, peer: Start, topic: str) -> None:
    process = peer(language)
    assert process.opens("x", "sub", topic, "mode=640", "group=users") == 0
    for file in (file_of(topic), semaphore_of(topic)):
        assert (file.stat().st_mode & 0o7777, file.stat().st_gid) == (0o640, grp.getgrnam("users").gr_gid)
    assert process.opens("y", "sub", topic, "mode=660", "group=0") == 0
    assert (file_of(topic).stat().st_mode & 0o7777, file_of(topic).stat().st_gid) == (0o660, 0)
    file_of(topic).chmod(0o666)
    assert process.opens("y", "sub", topic) == STRANGER
    assert process.opens("y", "sub", topic, "mode=666") == 0
    file_of(topic).chmod(0o660)
    semaphore_of(topic).chmod(0o666)
    assert process.opens("y", "sub", topic) == STRANGER
    semaphore_of(topic).chmod(0o660)
    os.chown(file_of(topic), 54321, 54321)
    assert process.opens("y", "sub", topic) == STRANGER
    assert process.opens("y", "sub", topic, "group=54321") == 0
    os.chown(file_of(topic), 999, 54321)  # a service of the machine
    os.chown(semaphore_of(topic), 999, 54321)
    assert process.opens("y", "sub", topic) == 0


# --- one writer -------------------------------------------------------------------------------------


def test_one_writer_among_processes(language: str, peer: Start, demo: Demo, topic: str) -> None:
    one, other = peer(language), peer("c")
    assert (one.opens("w", "pub", topic), other.opens("w", "pub", topic)) == (0, IN_USE)
    with pytest.raises(RegionInUse, match=str(one.pid)):
        demo.python.DemoPublisher(topic)
    assert one.does("publish w 1") == 0
    one.kill()
    with demo.python.DemoPublisher(topic) as publisher:
        assert publisher.sequence == 1
        assert other.opens("w", "pub", topic) == IN_USE
    assert other.opens("w", "pub", topic) == 0
    assert other.does("publish w 2") == 0
    assert Memory(topic)["completed0"] == 2


def test_a_plc_is_watched_and_its_numbers_left_to_it(
    language: str, peer: Start, demo: Demo, clock: Clock, topic: str
) -> None:
    process = peer(language)
    block = demo.opened(topic)
    first = block.udiSequence
    process.tell(f"open w {language} pub {topic}")
    while Memory(topic)["lock_count"] == 0:
        pass
    time.sleep(0.3)
    block()  # it lives
    assert int(process.hear().split()[0]) == IN_USE
    assert process.opens("w", "pub", topic, "start=1") == OPENING
    begun = time.monotonic()
    while (status := process.does("step w")) == OPENING:
        pass
    assert (status, process.does("publish w 1")) == (0, 0)
    assert 1.1 <= time.monotonic() - begun < 5
    memory = Memory(topic)  # the PLC's next number is left out, and that in whose slot of this lane nothing lies
    assert (memory["completed0"], memory["completed1"]) == (first + 1, first + 1 + 2)
    assert (block().xSent, block.eErrorID) == (False, "WRITER_IN_USE")
    assert Memory(topic)["writer"] == process.pid


def test_who_has_lost_writes_nothing_more(language: str, peer: Start, demo: Demo, clock: Clock, topic: str) -> None:
    """A PLC takes over while a sample is half written: it is void, and the next call says so too."""
    process = peer(language)
    assert (process.opens("w", "pub", topic), process.does("publish w 1")) == (0, 0)
    assert process.does("begin w 2") == 0
    process.process.send_signal(signal.SIGSTOP)
    block = demo.publisher(topic)
    for ms in (0, CLAIM, CONFIRM, CLAIM):
        clock.add(ms)
        block()
    clock.add(CLAIM)
    for _ in range(3):
        clock.add(CONFIRM)
        block.Msg.a = 9
        block()
    assert block.xSent
    newest = Memory(topic)["completed1"]
    process.process.send_signal(signal.SIGCONT)
    assert (process.does("complete w"), process.does("publish w 3"), process.does("step w")) == (LOST, LOST, LOST)
    assert (Memory(topic)["completed0"], Memory(topic)["completed1"]) == (1, newest)
    slot = 192 + 2 % SLOTS * 128  # that of the copy it was in; the PLC's lie in the other lane
    assert struct.unpack_from("<I", Memory(topic).bytes(), slot + 8) == (0,)
    with demo.python.DemoSubscriber(topic) as subscriber:
        assert subscriber.read().a == 9
    assert process.opens("w", "pub", topic) in (0, IN_USE)


def test_a_claim_is_lost_between_two_samples(language: str, peer: Start, demo: Demo, topic: str) -> None:
    process = peer(language)
    for call in ("publish w 1", "heartbeat w"):
        assert process.opens("w", "pub", topic) == 0
        memory = Memory(topic)
        before, memory["writer"] = (memory.bytes()[192:], memory["heartbeat"]), 0xFFFFFFFF
        assert (process.does(call), process.does("publish w 2")) == (LOST, LOST)
        assert (memory.bytes()[192:], memory["heartbeat"]) == before
        memory["writer"] = 0
    with demo.python.DemoPublisher(topic) as publisher:  # its record lock is given back
        Memory(topic)["writer"] = process.pid
        with pytest.raises(ClaimLost):
            publisher.publish(demo.message(1))


# --- the lock ---------------------------------------------------------------------------------------


def test_a_lock_heals(language: str, peer: Start, demo: Demo, topic: str) -> None:
    """Killed inside; whoever comes next waits no longer than 50 ms and its limit, and Python after it not at all."""
    process, dead = peer(language), peer("c")
    assert (process.opens("w", "pub", topic), dead.opens("x", "sub", topic)) == (0, 0)
    assert process.does("publish w 1") == 0
    assert dead.ask("enter x") == "1"
    dead.kill()
    assert semaphore(topic).value == 0
    begun, a = time.monotonic(), 2
    assert process.does("publish w 2") == 0
    Memory(topic)["lock_count"] += 1  # another stay, and that of a dead process as well
    while not Memory(topic)["recoveries"]:
        assert time.monotonic() - begun < 20, "the lock does not heal"
        assert process.does(f"publish w {(a := a + 1)}") == 0
    assert semaphore(topic).value == 1
    assert Memory(topic)["lock_holder"] == 0
    with demo.python.DemoSubscriber(topic) as subscriber:
        assert subscriber.read().a == a


def test_a_limit_of_many_seconds_waits_no_longer_for_a_dead_holder(peer: Start, topic: str) -> None:
    process, dead = peer("c"), peer("c")
    assert (process.opens("r", "sub", topic), dead.opens("x", "sub", topic)) == (0, 0)
    assert dead.ask("enter x") == "1"
    dead.kill()
    begun = time.monotonic()
    assert process.ask("enter r 20000") == "1"
    assert time.monotonic() - begun < 10
    assert Memory(topic)["recoveries"] == 1


def test_a_reader_leaves_the_lock_alone(language: str, peer: Start, topic: str) -> None:
    """On x86, be it free or held, until a writer is quicker than a copy: tests/rigs/chaos.py."""
    process = peer(language)
    assert (process.opens("w", "pub", topic), process.opens("r", "sub", topic)) == (0, 0)
    for a, call in enumerate(("read", "next", "try"), 1):
        assert process.does(f"publish w {a}") == 0
        assert process.ask(f"{call} r").split()[:2] == ["0", str(a)]
    assert Memory(topic)["lock_count"] == 3
    assert process.does("begin w 4") == 0
    assert process.does("read r") == NOTHING
    assert process.does("complete w") == 0
    semaphore(topic).acquire()
    assert process.ask("read r").split()[:2] == ["0", "4"]
    assert Memory(topic)["lock_count"] == 4


def test_tokens_too_many_go(language: str, peer: Start, topic: str) -> None:
    process = peer(language)
    assert process.opens("w", "pub", topic) == 0
    lock = semaphore(topic)
    for _ in range(80):
        lock.release()
    assert process.does("publish w 1") == 0
    assert 1 < lock.value < 80
    assert process.does("publish w 2") == 0
    assert lock.value == 1


def test_a_lock_that_is_held_costs_its_limit_once(language: str, peer: Start, demo: Demo, topic: str) -> None:
    process = peer(language)
    assert (process.opens("w", "pub", topic, "lock_us=200000"), process.opens("r", "sub", topic)) == (0, 0)
    semaphore(topic).acquire()
    Memory(topic)["lock_holder"] = os.getpid()
    begun = time.monotonic()
    assert process.does("publish w 1") == 0  # x86-64 goes on without it
    assert time.monotonic() - begun >= 0.2
    begun = time.monotonic()
    for a in range(2, 20):
        assert process.does(f"publish w {a}") == 0
    assert time.monotonic() - begun < 18 * 0.2
    assert process.ask("try r").split()[1] == "19"


def test_a_new_region_counts_from_one_again(language: str, peer: Start, topic: str) -> None:
    """Numbers that leap back are a region begun anew, and none counts as missed."""
    process = peer(language)
    assert (process.opens("w", "pub", topic), process.opens("r", "sub", topic)) == (0, 0)
    for a in range(1, 9):
        assert process.does(f"publish w {a}") == 0
    assert process.reads("read r") is not None
    memory = Memory(topic)
    memory["completed0"] = 3
    memory.poke(192 + 128 + 8, struct.pack("<I", 3))  # in the slot of 7
    assert process.ask("all r") == "0 7"
    assert process.ask("figures r").split()[:2] == ["3", "7"]


def test_a_forked_child_has_nothing(language: str, peer: Start, demo: Demo, topic: str) -> None:
    """It is told, it writes nothing, and what it lets go of stays its parent's."""
    process = peer(language)
    assert (process.opens("w", "pub", topic), process.opens("r", "sub", topic)) == (0, 0)
    assert process.does("publish w 1") == 0
    before = Memory(topic).bytes()
    assert process.ask("fork w") == "0"
    assert Memory(topic).bytes() == before
    with pytest.raises(RegionInUse):
        demo.python.DemoPublisher(topic)
    assert process.does("publish w 2") == 0
    assert process.reads("read r") == ["2", "4", "x2", "2", "-2"]
