"""Tests of C and C++ against docs/protocol.md: refused regions, one writer per topic, and recovery of a stuck lock."""

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
UNTRUSTED, SEMAPHORE, OPEN_FAILED, IN_USE, LOST, OPENING, NOTHING = 16, 31, 13, 40, 41, 102, 100


def file_of(topic: str) -> Path:
    return Path("/dev/shm") / region_name(topic)


def semaphore_of(topic: str) -> Path:
    return Path("/dev/shm") / f"sem.{region_name(topic)}"


@contextmanager
def hold_writer_lock(topic: str) -> Iterator[None]:
    """Hold a writer's record lock, so that no other process replaces the region."""
    with file_of(topic).open("r+b") as file:
        assert lock_byte(file.fileno(), WRITER_LOCK)
        yield


# --- existing regions -------------------------------------------------------------------------------


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
def test_invalid_topic_or_option_is_refused(topic_name: str, status: int, peer: Start) -> None:
    process = peer("c")
    if topic_name:
        assert process.opens("x", "sub", topic_name) == status
    assert process.opens("x", "sub", "/a", "depth=65536") == 4
    assert process.opens("x", "sub", "/a", "lock_us=1000001") == 6
    assert process.opens("x", "sub", "/a", "group=no_such_group") == 7
    assert not file_of("/a").exists()


def test_region_of_another_layout_or_depth_is_refused(language: str, peer: Start, demo: Demo, topic: str) -> None:
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


def test_header_equals_the_header_that_python_writes(language: str, peer: Start, demo: Demo, topic: str) -> None:
    assert peer(language).opens("x", "sub", topic) == 0
    with demo.python.DemoSubscriber(f"{topic}/python"):
        assert Memory(topic).bytes() == Memory(f"{topic}/python").bytes()


STATUS_BY_OFFSET = {0: NO_REGION, 4: ABI, 6: ABI, 8: DIGEST, 16: PAYLOAD, 20: PAYLOAD, 28: DEPTH, 33: DIGEST}
"""The status at opening, by the offset of the damaged byte."""


def test_damaged_header_field_or_size_is_refused(language: str, peer: Start, topic: str) -> None:
    process = peer(language)
    assert process.opens("x", "sub", topic) == 0
    data = file_of(topic).read_bytes()
    with hold_writer_lock(topic):
        for offset, status in STATUS_BY_OFFSET.items():
            file_of(topic).write_bytes(data[:offset] + bytes([data[offset] ^ 0x41]) + data[offset + 1 :])
            assert (offset, process.opens("y", "sub", topic)) == (offset, status)
            assert process.opens("y", "pub", topic) == status
        for size in (192, len(data) + 4096):
            file_of(topic).write_bytes(data.ljust(size, b"\0")[:size])
            assert process.opens("y", "sub", topic) == SIZE
    file_of(topic).write_bytes(b"\0" * 4096)  # its creator died before it wrote the header
    assert process.opens("y", "sub", topic) == 0
    assert file_of(topic).read_bytes()[:32] == data[:32]
    file_of(topic).write_bytes(b"")  # its creator died before it set the size
    assert process.opens("y", "sub", topic) == 0


def test_region_padded_to_larger_pages_is_accepted(language: str, peer: Start, topic: str) -> None:
    """Accept padding with zeros, as on a Raspberry Pi 5. Refuse other bytes in the padding, and other sizes."""
    process = peer(language)
    assert process.opens("made", "pub", topic) == 0
    data = file_of(topic).read_bytes()
    process.does("close made")
    for page in (16384, 65536):
        for content in (data, b""):  # a complete region, and a region that is still being created
            file_of(topic).write_bytes(content.ljust(page, b"\0"))
            assert (process.opens("w", "pub", topic), process.opens("r", "sub", topic)) == (0, 0)
            assert process.does(f"publish w {page}") == 0
            sample = process.reads("read r")
            assert sample
            assert (sample[0], file_of(topic).stat().st_size) == (str(page), page)
            process.does("close w"), process.does("close r")
        with hold_writer_lock(topic):
            for offset in (len(data), page - 1):
                file_of(topic).write_bytes(data.ljust(offset, b"\0") + b"1".ljust(page - offset, b"\0"))
                assert (offset, process.opens("x", "sub", topic)) == (offset, SIZE)
    with hold_writer_lock(topic):
        for size in (8192, 3 * 16384):
            file_of(topic).write_bytes(data.ljust(size, b"\0"))
            assert (size, process.opens("x", "sub", topic)) == (size, SIZE)


def test_symlink_fifo_or_damaged_semaphore_is_refused(language: str, peer: Start, topic: str, tmp_path: Path) -> None:
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


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can change the owner of a file")
def test_mode_group_and_owner_of_files_are_checked(language: str, peer: Start, topic: str) -> None:
    process = peer(language)
    assert process.opens("x", "sub", topic, "mode=640", "group=users") == 0
    for file in (file_of(topic), semaphore_of(topic)):
        assert (file.stat().st_mode & 0o7777, file.stat().st_gid) == (0o640, grp.getgrnam("users").gr_gid)
    assert process.opens("y", "sub", topic, "mode=660", "group=0") == 0
    assert (file_of(topic).stat().st_mode & 0o7777, file_of(topic).stat().st_gid) == (0o660, 0)
    file_of(topic).chmod(0o666)
    assert process.opens("y", "sub", topic) == UNTRUSTED
    assert process.opens("y", "sub", topic, "mode=666") == 0
    file_of(topic).chmod(0o660)
    semaphore_of(topic).chmod(0o666)
    assert process.opens("y", "sub", topic) == UNTRUSTED
    semaphore_of(topic).chmod(0o660)
    os.chown(file_of(topic), 54321, 54321)
    assert process.opens("y", "sub", topic) == UNTRUSTED
    assert process.opens("y", "sub", topic, "group=54321") == 0
    os.chown(file_of(topic), 999, 54321)  # a system account
    os.chown(semaphore_of(topic), 999, 54321)
    assert process.opens("y", "sub", topic) == 0


# --- one writer -------------------------------------------------------------------------------------


def test_topic_has_one_writer_among_processes(language: str, peer: Start, demo: Demo, topic: str) -> None:
    first, second = peer(language), peer("c")
    assert (first.opens("w", "pub", topic), second.opens("w", "pub", topic)) == (0, IN_USE)
    with pytest.raises(RegionInUse, match=str(first.pid)):
        demo.python.DemoPublisher(topic)
    assert first.does("publish w 1") == 0
    first.kill()
    with demo.python.DemoPublisher(topic) as publisher:
        assert publisher.sequence == 1
        assert second.opens("w", "pub", topic) == IN_USE
    assert second.opens("w", "pub", topic) == 0
    assert second.does("publish w 2") == 0
    assert Memory(topic)["completed0"] == 2


def test_takeover_waits_for_a_plc_and_skips_its_next_number(
    language: str, peer: Start, demo: Demo, clock: Clock, topic: str
) -> None:
    process = peer(language)
    block = demo.opened(topic)
    first = block.udiSequence
    process.tell(f"open w {language} pub {topic}")
    while Memory(topic)["lock_count"] == 0:
        pass
    time.sleep(0.3)
    block()  # the PLC is alive
    assert int(process.hear().split()[0]) == IN_USE
    assert process.opens("w", "pub", topic, "start=1") == OPENING
    started_at = time.monotonic()
    while (status := process.does("step w")) == OPENING:
        pass
    assert (status, process.does("publish w 1")) == (0, 0)
    assert 1.1 <= time.monotonic() - started_at < 5
    memory = Memory(topic)  # lane 1 continues after `left`, which is the PLC's next number
    assert (memory["completed0"], memory["completed1"]) == (first + 1, first + 1 + 2)
    assert (block().xSent, block.eErrorID) == (False, "WRITER_IN_USE")
    assert Memory(topic)["writer"] == process.pid


def test_former_writer_writes_nothing(language: str, peer: Start, demo: Demo, clock: Clock, topic: str) -> None:
    """Discard a half-written sample if a PLC takes over. Report the loss from each later call."""
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
    slot = 192 + 2 % SLOTS * 128  # slot of the half-written sample; the PLC uses the other lane
    assert struct.unpack_from("<I", Memory(topic).bytes(), slot + 8) == (0,)
    with demo.python.DemoSubscriber(topic) as subscriber:
        assert subscriber.read().a == 9
    assert process.opens("w", "pub", topic) in (0, IN_USE)


def test_claim_lost_between_two_samples_is_reported(language: str, peer: Start, demo: Demo, topic: str) -> None:
    process = peer(language)
    for call in ("publish w 1", "heartbeat w"):
        assert process.opens("w", "pub", topic) == 0
        memory = Memory(topic)
        before, memory["writer"] = (memory.bytes()[192:], memory["heartbeat"]), 0xFFFFFFFF
        assert (process.does(call), process.does("publish w 2")) == (LOST, LOST)
        assert (memory.bytes()[192:], memory["heartbeat"]) == before
        memory["writer"] = 0
    with demo.python.DemoPublisher(topic) as publisher:  # the process released its record lock
        Memory(topic)["writer"] = process.pid
        with pytest.raises(ClaimLost):
            publisher.publish(demo.message(1))


# --- the lock ---------------------------------------------------------------------------------------


def test_lock_of_a_dead_process_is_recovered(language: str, peer: Start, demo: Demo, topic: str) -> None:
    """Recover the lock while publishing. Python then reads the newest sample."""
    process, dead = peer(language), peer("c")
    assert (process.opens("w", "pub", topic), dead.opens("x", "sub", topic)) == (0, 0)
    assert process.does("publish w 1") == 0
    assert dead.ask("enter x") == "1"
    dead.kill()
    assert semaphore(topic).value == 0
    started_at, a = time.monotonic(), 2
    assert process.does("publish w 2") == 0
    Memory(topic)["lock_count"] += 1  # as if another process, dead as well, held the lock
    while not Memory(topic)["recoveries"]:
        assert time.monotonic() - started_at < 20, "the lock was not recovered"
        assert process.does(f"publish w {(a := a + 1)}") == 0
    assert semaphore(topic).value == 1
    assert Memory(topic)["lock_holder"] == 0
    with demo.python.DemoSubscriber(topic) as subscriber:
        assert subscriber.read().a == a


def test_long_timeout_does_not_delay_the_recovery_of_a_lock(peer: Start, topic: str) -> None:
    process, dead = peer("c"), peer("c")
    assert (process.opens("r", "sub", topic), dead.opens("x", "sub", topic)) == (0, 0)
    assert dead.ask("enter x") == "1"
    dead.kill()
    started_at = time.monotonic()
    assert process.ask("enter r 20000") == "1"
    assert time.monotonic() - started_at < 10
    assert Memory(topic)["recoveries"] == 1


def test_reader_does_not_take_the_lock(language: str, peer: Start, topic: str) -> None:
    """Read without the lock on x86, whether it is free or held."""
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


def test_excess_semaphore_tokens_are_removed(language: str, peer: Start, topic: str) -> None:
    process = peer(language)
    assert process.opens("w", "pub", topic) == 0
    lock = semaphore(topic)
    for _ in range(80):
        lock.release()
    assert process.does("publish w 1") == 0
    assert 1 < lock.value < 80
    assert process.does("publish w 2") == 0
    assert lock.value == 1


def test_held_lock_delays_the_writer_only_once(language: str, peer: Start, demo: Demo, topic: str) -> None:
    process = peer(language)
    assert (process.opens("w", "pub", topic, "lock_us=200000"), process.opens("r", "sub", topic)) == (0, 0)
    semaphore(topic).acquire()
    Memory(topic)["lock_holder"] = os.getpid()
    started_at = time.monotonic()
    assert process.does("publish w 1") == 0  # x86-64 continues without the lock
    assert time.monotonic() - started_at >= 0.2
    started_at = time.monotonic()
    for a in range(2, 20):
        assert process.does(f"publish w {a}") == 0
    assert time.monotonic() - started_at < 18 * 0.2
    assert process.ask("try r").split()[1] == "19"


def test_reader_counts_no_missed_samples_in_a_new_region(language: str, peer: Start, topic: str) -> None:
    """Take sample numbers that jump back for the numbers of a recreated region."""
    process = peer(language)
    assert (process.opens("w", "pub", topic), process.opens("r", "sub", topic)) == (0, 0)
    for a in range(1, 9):
        assert process.does(f"publish w {a}") == 0
    assert process.reads("read r") is not None
    memory = Memory(topic)
    memory["completed0"] = 3
    memory.poke(192 + 128 + 8, struct.pack("<I", 3))  # the slot of sample 7
    assert process.ask("all r") == "0 7"
    assert process.ask("figures r").split()[:2] == ["3", "7"]


def test_forked_child_can_neither_publish_nor_read(language: str, peer: Start, demo: Demo, topic: str) -> None:
    """Report the fork to the child. The parent keeps its claim."""
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
