"""What outlives a process: its lock, healed; its wake-up, taken over; its heartbeat, missed."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace
from unittest.mock import Mock, call

import posix_ipc
import pytest

from shmgen import runtime
from shmgen.core import abi
from shmgen.core.abi import REPAIR_LOCK
from shmgen.runtime import engine
from shmgen.runtime.reference import lock
from shmgen.runtime.reference import reader as reading
from shmgen.runtime.reference.region import Semaphore
from shmgen.runtime.region import header as h
from shmgen.runtime.region import record_locks
from shmgen.runtime.region.names import event_name

from ..support import machine
from ..support.region_of import region_of
from .messages import WHY_NOT, PosePublisher, PoseSubscriber, pose

NEVER = 1e9
SOON = 0.05
LATE = 20.0
"""Seconds; a busy machine takes long for what is over at once."""


each_engine = pytest.mark.usefixtures("each_engine")
in_python = pytest.mark.usefixtures("in_python")
in_c = pytest.mark.skipif(not engine.IN_C, reason=WHY_NOT)


@pytest.fixture
def value(topic):
    """The value of the region's semaphore, or of its event."""

    def look(name=None):
        semaphore = posix_ipc.Semaphore("/" + (name or runtime.region_name(topic)))
        try:
            return semaphore.value
        finally:
            semaphore.close()

    return look


def dead_pid():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def leave_locked(side, holder):
    """As a process killed inside leaves it."""
    words = region_of(side).words
    semaphore = posix_ipc.Semaphore("/" + region_of(side).name)
    semaphore.acquire(0)
    semaphore.close()
    words[h.LOCK_COUNT] += 1
    words[h.LOCK_HOLDER] = holder


def until(condition, deadline=20.0):
    end = time.monotonic() + deadline
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


# --- healing -------------------------------------------------------------------------------------


@in_c
@pytest.mark.skipif(machine.EMULATED, reason="seconds, which qemu-user does not keep")
@pytest.mark.parametrize(
    ("holder", "least"),
    [
        pytest.param(dead_pid, 0.05, id="dead"),
        pytest.param(lambda: 0, 1.0, id="nobody"),
        pytest.param(lambda: h.PLC, 1.0, id="PLC"),
        pytest.param(os.getppid, 1.0, id="alive"),
        pytest.param(lambda: 2**31, 1.0, id="no pid"),
    ],
)
@pytest.mark.family("[PLC]", "[alive]")
def test_the_engine_in_c_heals_in_time(topic, value, holder, least):
    """The best of three counts, where others take the processors."""
    took = []
    with PosePublisher(topic) as publisher:
        words = region_of(topic).words
        while len(took) < 3 and not (took and took[-1] < 1.2 * least + 0.02):
            publisher.publish(pose(0))
            before = words[h.RECOVERIES]
            leave_locked(publisher, holder())
            start = time.monotonic()
            while words[h.RECOVERIES] == before:
                publisher.publish(pose(1))
            took.append(time.monotonic() - start)
            assert took[-1] >= least
            assert (words[h.LOCK_HOLDER], value()) == (0, 1)
    assert took[-1] < 1.2 * least + 0.02, took


@each_engine
def test_the_lock_of_a_killed_process_is_healed(topic, other, value):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(0))
        holder = other("inside", topic)
        assert region_of(publisher).words[h.LOCK_HOLDER] == holder.process.pid
        holder.kill()
        # The writer goes on meanwhile: the number moves, `lock_count` does not.
        until(lambda: publisher.publish(pose(1)) or region_of(publisher).words[h.RECOVERIES])
        misses = publisher.lock_misses
        publisher.publish(pose(2))
        assert subscriber.read().position.x == 2.0
        assert (publisher.lock_misses, subscriber.lock_misses) == (misses, 0)
        found = runtime.read_header(runtime.region_name(topic))
        assert (found.recoveries, found.lock_holder, value()) == (1, 0, 1)


@pytest.mark.usefixtures("on_x86")
@pytest.mark.parametrize("holder", [dead_pid, lambda: 0, lambda: h.PLC, os.getppid, lambda: 1, lambda: 2**31])
def test_only_a_dead_process_is_healed_early(topic, monkeypatch, value, holder):
    """A pid that lives may be another process by now; that, the PLC and nobody are judged by the long rule."""
    pid = holder()
    early = holder is dead_pid
    monkeypatch.setattr(lock, "_DEAD_AFTER", SOON)
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(0))
        monkeypatch.setattr(lock, "_STUCK_AFTER", NEVER)
        leave_locked(publisher, pid)
        end = time.monotonic() + 4 * SOON
        while time.monotonic() < end:
            publisher.publish(pose(1))
        assert region_of(publisher).words[h.RECOVERIES] == early
        monkeypatch.setattr(lock, "_STUCK_AFTER", 4 * SOON)
        # A reader heals as well.
        until(lambda: publisher.publish(pose(2)) or (subscriber.read() and region_of(publisher).words[h.RECOVERIES]))
        assert (region_of(publisher).words[h.RECOVERIES], region_of(publisher).words[h.LOCK_HOLDER], value()) == (
            1,
            0,
            1,
        )


def test_a_holder_is_only_asked_after(monkeypatch):
    kill = Mock(side_effect=[None, PermissionError, ProcessLookupError])
    monkeypatch.setattr(os, "kill", kill)
    assert [lock._is_dead(4242) for _ in range(3)] == [False, False, True]
    assert kill.mock_calls == [call(4242, 0)] * 3


@pytest.mark.usefixtures("on_x86")
def test_a_lock_is_watched_from_the_opening_on_only_if_it_is_not_free(topic, monkeypatch):
    monkeypatch.setattr(lock, "_STUCK_AFTER", 4 * SOON)
    for stuck in (True, False):
        with PoseSubscriber(topic) as holder:
            if stuck:
                leave_locked(holder, 0)
            with PosePublisher(topic) as publisher:
                time.sleep(5 * SOON)
                if not stuck:
                    leave_locked(holder, 0)
                publisher.publish(pose(1))
                assert region_of(publisher).words[h.RECOVERIES] == 1
                assert publisher.lock_misses == (not stuck)


@pytest.mark.usefixtures("on_x86")
@pytest.mark.parametrize(("holder", "after"), [(dead_pid, lock._DEAD_AFTER), (lambda: 0, lock._STUCK_AFTER)])
def test_a_lock_that_others_pass_is_not_stuck(topic, monkeypatch, holder, after):
    now = 0.0  # so that sums are exact
    with PosePublisher(topic, lock_timeout=0) as publisher:
        monkeypatch.setattr(lock, "time", SimpleNamespace(monotonic=lambda: now))
        leave_locked(publisher, holder())
        words = region_of(publisher).words
        for _ in range(40):
            publisher.publish(pose(1))
            words[h.LOCK_COUNT] += 1
            now += after / 2
        assert words[h.RECOVERIES] == 0
        now = 0.0
        words[h.LOCK_COUNT] += 1
        for instant, healed in ((0.0, 0), (after * 0.99, 0), (after, 1)):
            now = instant
            publisher.publish(pose(1))
            assert words[h.RECOVERIES] == healed


@pytest.mark.usefixtures("on_x86")
def test_a_wait_sleeps(topic, monkeypatch):
    """A processor is not burnt for as long as somebody else is inside."""
    naps, now = [], 0.0

    def sleep(seconds):
        nonlocal now
        naps.append(seconds)
        now += seconds

    with PosePublisher(topic, lock_timeout=0.005) as publisher:
        monkeypatch.setattr(lock, "time", SimpleNamespace(monotonic=lambda: now, sleep=sleep))
        leave_locked(publisher, os.getpid())
        publisher.publish(pose(1))
        assert (len(naps), set(naps)) == (pytest.approx(50, abs=1), {1e-4})
        first = len(naps)
        publisher.publish(pose(2))  # the same stay: no second wait
        assert (len(naps), publisher.lock_misses) == (first, 2)
        with PoseSubscriber(topic, lock_timeout=0.005) as subscriber:  # opened while somebody is inside
            subscriber._end.last = 0
            assert subscriber.read().position.x == 2.0
            assert (len(naps), subscriber.lock_misses) == (pytest.approx(2 * first, abs=2), 1)
        del naps[:]
        region_of(publisher).words[h.LOCK_COUNT] += 1  # another is inside
        assert not publisher._end.lock.acquire(0.002)  # a call that ends before the limit does
        assert len(naps) == pytest.approx(20, abs=1)


@in_python
def test_a_token_that_others_post_at_each_try_is_not_ours(topic, monkeypatch, value):
    """Else the next call would believe to be inside, and give back what it does not hold."""
    with PosePublisher(topic) as publisher:
        semaphore = publisher._end.region.semaphore
        with monkeypatch.context() as patch:
            patch.setattr(Semaphore, "post", lambda self: False)
            patch.setattr(Semaphore, "value", 1)
            publisher.publish(pose(1))
        assert semaphore.held == []
        semaphore.post()
        publisher.publish(pose(2))
        assert value() == 1


@in_python
def test_a_region_without_a_lock_is_not_entered(topic):
    assert Semaphore("").acquire() is False
    with PosePublisher(topic) as publisher:
        publisher._end.region.semaphore = Semaphore("")
        assert not publisher._end.lock.acquire()
        assert publisher.lock_misses == 0


@pytest.mark.usefixtures("on_x86")
def test_one_healer_at_a_time(topic, monkeypatch, value):
    monkeypatch.setattr(lock, "_DEAD_AFTER", 0.0)
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        leave_locked(publisher, dead_pid())
        healer = region_of(subscriber)
        assert record_locks.lock_byte(healer.file, REPAIR_LOCK)
        for _ in range(5):
            publisher.publish(pose(1))
        assert (region_of(publisher).words[h.RECOVERIES], value()) == (0, 0)
        record_locks.unlock_byte(healer.file, REPAIR_LOCK)
        # Both have taken it to be stuck; the second looks once more.
        stay = publisher._end.lock._stay()
        assert publisher._end.lock._recover(stay)
        assert not subscriber._end.lock._recover(stay)
        assert (region_of(publisher).words[h.RECOVERIES], value()) == (1, 0)
        publisher._end.lock.release()
        assert value() == 1


@in_python
@pytest.mark.parametrize(("count", "after"), [(0, 1), (7, 8), (h.LAST, 0)])
def test_taking_over_is_a_stay_of_its_own(topic, count, after):
    """Otherwise whoever has the same number as the dead one, in another container, would be taken for dead as well."""
    with PosePublisher(topic) as publisher:
        leave_locked(publisher, 1)
        region_of(publisher).words[h.LOCK_COUNT] = count
        assert publisher._end.lock._recover((1, count))
        assert publisher._end.lock._stay() == (os.getpid(), after)
        publisher._end.lock.release()


@in_python
def test_a_lock_that_came_free_is_entered_not_healed(topic):
    with PosePublisher(topic) as publisher:
        assert publisher._end.lock._recover(publisher._end.lock._stay())
        assert region_of(publisher).words[h.RECOVERIES] == 0


@each_engine
def test_a_holder_that_comes_back_leaves_no_surplus(topic, other, monkeypatch, value):
    with PosePublisher(topic) as publisher:
        monkeypatch.setattr(lock, "_STUCK_AFTER", SOON)
        holder = other("hold", topic)
        until(lambda: publisher.publish(pose(1)) or region_of(publisher).words[h.RECOVERIES])
        holder.end()
        assert value() == 1, "it sees that the token is there, and posts none"


@pytest.mark.usefixtures("on_arm")
def test_where_the_lock_is_needed_a_call_lasts_until_it_is_healed(topic, value):
    """And raises nothing: publish() by its own limit, wait() by that of the call, read() has nothing new meanwhile."""
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        for holder, soonest in ((dead_pid(), lock._DEAD_AFTER), (h.PLC, lock._STUCK_AFTER)):
            leave_locked(publisher, holder)
            start = time.monotonic()
            publisher.publish(pose(2))
            assert soonest <= time.monotonic() - start < soonest + LATE
        leave_locked(publisher, os.getpid())
        assert subscriber.read() is None
        region_of(publisher).words[h.LOCK_HOLDER] = dead_pid()
        assert subscriber.wait(10).position.x == 2.0
        assert (region_of(publisher).words[h.RECOVERIES], value()) == (3, 1)
        assert (publisher.lock_misses, subscriber.lock_misses) == (0, 1)


@pytest.mark.usefixtures("on_arm")
def test_where_the_lock_is_needed_a_time_limit_is_a_time_limit(topic, monkeypatch):
    with (
        PosePublisher(topic) as publisher,
        PoseSubscriber(topic, lock_timeout=1) as subscriber,
        PoseSubscriber(topic, lock_timeout=0) as impatient,
    ):
        publisher.publish(pose(1))
        leave_locked(publisher, os.getpid())
        threading.Timer(0.03, PosixRelease(topic)).start()
        publisher.publish(pose(2))  # a live holder of 30 ms

        monkeypatch.setattr(lock, "_STUCK_AFTER", NEVER)
        leave_locked(publisher, os.getpid())
        publisher._end.lock.timeout = 0.05
        for call, least in (
            (lambda: publisher._end.publish(pose(3), int(1e8)), 0.1),
            (lambda: publisher.publish(pose(3)), 0.05),  # again with its own
        ):
            start = time.monotonic()
            with pytest.raises(runtime.LockTimeout, match=f"held by process {os.getpid()}; nothing was published"):
                call()
            assert least <= time.monotonic() - start < LATE
        for reader in (subscriber, impatient):
            start = time.monotonic()
            assert reader.wait(0.1) is None
            assert 0.1 <= time.monotonic() - start < LATE
        PosixRelease(topic)()
        assert subscriber.read().position.x == 2.0


class PosixRelease:
    """What a holder does that comes out."""

    def __init__(self, topic, name=None):
        self.name = "/" + (name or runtime.region_name(topic))

    def __call__(self):
        semaphore = posix_ipc.Semaphore(self.name)
        semaphore.release()
        semaphore.close()


@each_engine
def test_a_signal_does_not_cut_a_wait_short(topic):
    """Neither one for the lock nor one for a sample."""
    former = signal.signal(signal.SIGALRM, lambda *_: None)
    with PosePublisher(topic, lock_timeout=1) as publisher, PoseSubscriber(topic) as subscriber:
        signal.setitimer(signal.ITIMER_REAL, 0.001, 0.001)
        try:
            leave_locked(publisher, os.getpid())
            threading.Timer(0.05, PosixRelease(topic)).start()
            publisher.publish(pose(1))
            assert publisher.lock_misses == 0
            assert subscriber.read()
            threading.Timer(0.05, publisher.publish, [pose(2)]).start()
            assert subscriber.wait(LATE).position.x == 2.0
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, former)


# --- waking up -----------------------------------------------------------------------------------


def naps_of(call):
    """How often this thread slept meanwhile."""
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    call()
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before


@in_c
def test_a_waiting_reader_is_woken_and_does_not_poll(topic, other):
    writer, heard, late = other("publish", topic), [], []
    with PoseSubscriber(topic) as subscriber:
        for x in range(20):

            def tell(x=x):
                until_armed(subscriber)
                writer.tell(float(x))
                heard.append(int(writer.hear()))
                late.append(time.monotonic())

            thread = threading.Thread(target=tell)
            thread.start()
            assert subscriber.wait(LATE).position.x == x
            woken = time.monotonic()
            thread.join()
            late[-1] = woken - late[-1]
            assert region_of(subscriber).words[h.ARMED] == 0
        assert heard == list(range(1, 21))
        assert min(late) < 0.002, "of ten milliseconds that a lost wake-up costs"
        assert naps_of(lambda: subscriber.wait(0.5)) < 100


def until_armed(subscriber):
    words = region_of(subscriber).words
    until(lambda: words[h.ARMED])


@each_engine
def test_nobody_is_woken_who_does_not_wait(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        assert subscriber.wait(0).position.x == 1.0
        publisher.publish(pose(2))
        assert (region_of(subscriber).words[h.ARMED], region_of(subscriber).words[h.BELL]) == (0, 0)


@in_c
def test_one_that_spins_long_enough_does_not_sleep(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic, spin=0.001) as subscriber:
        assert not subscriber.ready(0.0005)
        assert region_of(subscriber).words[h.ARMED] == 0
        assert not subscriber.ready(0.01)
        assert region_of(subscriber).words[h.ARMED] == 1
        publisher.publish(pose(1))
        assert subscriber.wait(LATE).position.x == 1.0


@pytest.mark.parametrize("spin", [-1e-6, 0.002, float("nan")])
def test_a_spin_that_cannot_be(topic, spin):
    with pytest.raises(ValueError, match=r"it goes from 0 to 0\.001 seconds"):
        PoseSubscriber(topic, spin=spin)


@pytest.mark.parametrize("locked", [False, True])
def test_a_reader_that_died_waiting_does_no_harm(topic, locked, each_engine):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        region_of(subscriber).words[h.ARMED] = 1
        assert subscriber.wait(0.02) is None
        if locked:
            leave_locked(publisher, 0)
        publisher.publish(pose(1))
        region_of(subscriber).words[h.ARMED] = 1
        publisher.publish(pose(2))
        assert (region_of(subscriber).words[h.ARMED], region_of(subscriber).words[h.BELL]) == (0, 2)
        assert subscriber.wait(5).position.x == 2.0


@in_c
def test_a_post_too_many_does_not_make_a_reader_poll_for_good(topic, value):
    """As a PLC leaves one where a sample came between `armed` and the second look."""
    event = event_name(runtime.region_name(topic))
    with PoseSubscriber(topic) as subscriber:
        region_of(subscriber).words[h.WRITER] = abi.PLC
        assert subscriber.wait(0.02) is None
        PosixRelease(topic, event)()
        assert naps_of(lambda: subscriber.wait(0.5)) < 100
        assert value(event) == 0


@in_c
def test_two_readers_that_wait_are_both_woken(topic):
    """Each by each sample, and by the writer itself: neither takes from the other what wakes it."""
    late = []

    def read(subscriber):
        for x in range(20):
            assert subscriber.wait(LATE).position.x == x
            late.append(time.monotonic() - published[x])

    published = {}
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as one, PoseSubscriber(topic) as other:
        threads = [threading.Thread(target=read, args=[side]) for side in (one, other)]
        for thread in threads:
            thread.start()
        for x in range(20):
            until_armed(one)
            time.sleep(0.005)
            published[x] = time.monotonic()
            publisher.publish(pose(x))
        for thread in threads:
            thread.join()
        assert one.missed == other.missed == 0
    assert sorted(late)[len(late) // 2] < 0.002, "of ten milliseconds that a lost wake-up costs"


@in_python
def test_the_reference_looks_each_millisecond(topic, monkeypatch):
    naps, now = [], 0.0

    def sleep(seconds):
        nonlocal now
        naps.append(seconds)
        now += seconds

    with PoseSubscriber(topic) as subscriber:
        monkeypatch.setattr(reading, "time", SimpleNamespace(monotonic=lambda: now, sleep=sleep))
        assert subscriber.ready(0.0015) is False
        assert naps == pytest.approx([0.001, 0.0005])
        assert region_of(topic).words[h.ARMED] == 0
        region_of(topic).words[h.COMPLETED0] = 1
        assert subscriber.ready(1) is True
        assert len(naps) == 2


@pytest.mark.usefixtures("on_x86")
def test_without_the_lock_a_fence_stands_between_completed_and_the_look_for_a_reader(topic, monkeypatch):
    with PosePublisher(topic, lock_timeout=0) as publisher:
        words, fences = region_of(publisher).words, []
        monkeypatch.setattr("shmgen.runtime.reference.writer.fence", lambda: fences.append(words[h.COMPLETED0]))
        publisher.publish(pose(1))
        leave_locked(publisher, 0)
        publisher.publish(pose(2))
        assert fences == [0, 1, 1, 2], "and one before the copy"


@each_engine
def test_each_of_several_waiting_readers_gets_it(topic, other):
    with PosePublisher(topic) as publisher:
        readers = [other("read", topic) for _ in range(3)]
        for x in range(5):
            for reader in readers:
                reader.tell("go")
            time.sleep(0.005)
            publisher.publish(pose(x))
            assert [reader.hear() for reader in readers] == [str(float(x))] * 3


# --- staleness -----------------------------------------------------------------------------------


@each_engine
def test_stale_when_the_heartbeat_stands_still(topic):
    with PoseSubscriber(topic) as subscriber:
        assert not subscriber.is_stale(60)
        time.sleep(0.03)
        assert subscriber.is_stale(0.02)
        with PosePublisher(topic) as publisher:
            for beat in (publisher.heartbeat, lambda: publisher.publish(pose(1))):
                beat()
                assert not subscriber.is_stale(0.02)
                time.sleep(0.03)
                assert subscriber.is_stale(0.02)
                assert not subscriber.is_stale(60)
