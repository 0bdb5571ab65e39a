"""A dead process blocks no other: its lock is recovered, other readers are woken, and its heartbeat becomes stale."""

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
"""Seconds that a busy machine may need for an immediate action."""


each_engine = pytest.mark.usefixtures("each_engine")
in_python = pytest.mark.usefixtures("in_python")
in_c = pytest.mark.skipif(not engine.IN_C, reason=WHY_NOT)


@pytest.fixture
def value(topic):
    """A function that returns the value of the region's semaphore, or of the named semaphore."""

    def read_value(name=None):
        semaphore = posix_ipc.Semaphore("/" + (name or runtime.region_name(topic)))
        try:
            return semaphore.value
        finally:
            semaphore.close()

    return read_value


def dead_pid():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def leave_locked(side, holder):
    """Leave the lock as a process does that is killed while it holds the lock."""
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


# --- recovery ------------------------------------------------------------------------------------


@in_c
@pytest.mark.skipif(machine.EMULATED, reason="qemu-user does not keep the time limits")
@pytest.mark.parametrize(
    ("holder", "minimum"),
    [
        pytest.param(dead_pid, 0.05, id="dead"),
        pytest.param(lambda: 0, 1.0, id="nobody"),
        pytest.param(lambda: h.PLC, 1.0, id="PLC"),
        pytest.param(os.getppid, 1.0, id="alive"),
        pytest.param(lambda: 2**31, 1.0, id="no pid"),
    ],
)
@pytest.mark.family("[PLC]", "[alive]")
def test_c_engine_recovers_the_lock_in_time(topic, value, holder, minimum):
    """Count the best of three attempts, because other processes may use the processors."""
    durations = []
    with PosePublisher(topic) as publisher:
        words = region_of(topic).words
        while len(durations) < 3 and not (durations and durations[-1] < 1.2 * minimum + 0.02):
            publisher.publish(pose(0))
            before = words[h.RECOVERIES]
            leave_locked(publisher, holder())
            start = time.monotonic()
            while words[h.RECOVERIES] == before:
                publisher.publish(pose(1))
            durations.append(time.monotonic() - start)
            assert durations[-1] >= minimum
            assert (words[h.LOCK_HOLDER], value()) == (0, 1)
    assert durations[-1] < 1.2 * minimum + 0.02, durations


@each_engine
def test_lock_of_a_killed_process_is_recovered(topic, other, value):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(0))
        holder = other("inside", topic)
        assert region_of(publisher).words[h.LOCK_HOLDER] == holder.process.pid
        holder.kill()
        # Meanwhile the writer continues: sample numbers increase, but `lock_count` does not.
        until(lambda: publisher.publish(pose(1)) or region_of(publisher).words[h.RECOVERIES])
        misses = publisher.lock_misses
        publisher.publish(pose(2))
        assert subscriber.read().position.x == 2.0
        assert (publisher.lock_misses, subscriber.lock_misses) == (misses, 0)
        header = runtime.read_header(runtime.region_name(topic))
        assert (header.recoveries, header.lock_holder, value()) == (1, 0, 1)


@pytest.mark.usefixtures("on_x86")
@pytest.mark.parametrize("holder", [dead_pid, lambda: 0, lambda: h.PLC, os.getppid, lambda: 1, lambda: 2**31])
def test_only_the_lock_of_a_dead_process_is_recovered_early(topic, monkeypatch, value, holder):
    """Wait longer if the holder is a PLC, unknown, or a live process id, which may belong to a new process."""
    pid = holder()
    is_early = holder is dead_pid
    monkeypatch.setattr(lock, "_DEAD_AFTER", SOON)
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(0))
        monkeypatch.setattr(lock, "_STUCK_AFTER", NEVER)
        leave_locked(publisher, pid)
        end = time.monotonic() + 4 * SOON
        while time.monotonic() < end:
            publisher.publish(pose(1))
        assert region_of(publisher).words[h.RECOVERIES] == is_early
        monkeypatch.setattr(lock, "_STUCK_AFTER", 4 * SOON)
        # A reader recovers the lock as well.
        until(lambda: publisher.publish(pose(2)) or (subscriber.read() and region_of(publisher).words[h.RECOVERIES]))
        assert (region_of(publisher).words[h.RECOVERIES], region_of(publisher).words[h.LOCK_HOLDER], value()) == (
            1,
            0,
            1,
        )


def test_holder_is_only_probed_with_signal_0(monkeypatch):
    kill = Mock(side_effect=[None, PermissionError, ProcessLookupError])
    monkeypatch.setattr(os, "kill", kill)
    assert [lock._is_dead(4242) for _ in range(3)] == [False, False, True]
    assert kill.mock_calls == [call(4242, 0)] * 3


@pytest.mark.usefixtures("on_x86")
def test_lock_is_watched_from_opening_only_if_it_is_busy(topic, monkeypatch):
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
def test_lock_acquired_by_others_is_not_stuck(topic, monkeypatch, holder, after):
    now = 0.0  # a simulated clock, so that sums are exact
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
        for instant, recoveries in ((0.0, 0), (after * 0.99, 0), (after, 1)):
            now = instant
            publisher.publish(pose(1))
            assert words[h.RECOVERIES] == recoveries


@pytest.mark.usefixtures("on_x86")
def test_wait_for_the_lock_sleeps(topic, monkeypatch):
    """Use little processor time while another process holds the lock."""
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
        publisher.publish(pose(2))  # the same acquisition: no second wait
        assert (len(naps), publisher.lock_misses) == (first, 2)
        with PoseSubscriber(topic, lock_timeout=0.005) as subscriber:  # opened while the lock is busy
            subscriber._end.last = 0
            assert subscriber.read().position.x == 2.0
            assert (len(naps), subscriber.lock_misses) == (pytest.approx(2 * first, abs=2), 1)
        del naps[:]
        region_of(publisher).words[h.LOCK_COUNT] += 1  # another holder
        assert not publisher._end.lock.acquire(0.002)  # the limit of this call is shorter than the lock timeout
        assert len(naps) == pytest.approx(20, abs=1)


@in_python
def test_lock_is_not_held_after_others_posted_tokens(topic, monkeypatch, value):
    """Forget the held lock. Otherwise the next call would release a lock that it does not hold."""
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
def test_region_without_a_lock_counts_no_lock_misses(topic):
    assert Semaphore("").acquire() is False
    with PosePublisher(topic) as publisher:
        publisher._end.region.semaphore = Semaphore("")
        assert not publisher._end.lock.acquire()
        assert publisher.lock_misses == 0


@pytest.mark.usefixtures("on_x86")
def test_only_one_process_at_a_time_recovers_the_lock(topic, monkeypatch, value):
    monkeypatch.setattr(lock, "_DEAD_AFTER", 0.0)
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        leave_locked(publisher, dead_pid())
        repairer = region_of(subscriber)
        assert record_locks.lock_byte(repairer.file, REPAIR_LOCK)
        for _ in range(5):
            publisher.publish(pose(1))
        assert (region_of(publisher).words[h.RECOVERIES], value()) == (0, 0)
        record_locks.unlock_byte(repairer.file, REPAIR_LOCK)
        # Both consider the lock stuck. The second checks again before its recovery.
        stay = publisher._end.lock._stay()
        assert publisher._end.lock._recover(stay)
        assert not subscriber._end.lock._recover(stay)
        assert (region_of(publisher).words[h.RECOVERIES], value()) == (1, 0)
        publisher._end.lock.release()
        assert value() == 1


@in_python
@pytest.mark.parametrize(("count", "after"), [(0, 1), (7, 8), (h.LAST, 0)])
def test_recovery_counts_as_a_new_acquisition(topic, count, after):
    """Change `lock_count`; otherwise a process with the same id in another container would be considered dead too."""
    with PosePublisher(topic) as publisher:
        leave_locked(publisher, 1)
        region_of(publisher).words[h.LOCK_COUNT] = count
        assert publisher._end.lock._recover((1, count))
        assert publisher._end.lock._stay() == (os.getpid(), after)
        publisher._end.lock.release()


@in_python
def test_lock_that_became_free_is_acquired_without_recovery(topic):
    with PosePublisher(topic) as publisher:
        assert publisher._end.lock._recover(publisher._end.lock._stay())
        assert region_of(publisher).words[h.RECOVERIES] == 0


@each_engine
def test_resumed_holder_leaves_no_surplus_token(topic, other, monkeypatch, value):
    with PosePublisher(topic) as publisher:
        monkeypatch.setattr(lock, "_STUCK_AFTER", SOON)
        holder = other("hold", topic)
        until(lambda: publisher.publish(pose(1)) or region_of(publisher).words[h.RECOVERIES])
        holder.end()
        assert value() == 1, "the holder finds the token and posts no second token"


@pytest.mark.usefixtures("on_arm")
def test_arm_calls_wait_until_the_lock_is_recovered(topic, value):
    """Raise no error: publish() and wait() wait within their limits, and read() returns None in the meantime."""
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        for holder, earliest in ((dead_pid(), lock._DEAD_AFTER), (h.PLC, lock._STUCK_AFTER)):
            leave_locked(publisher, holder)
            start = time.monotonic()
            publisher.publish(pose(2))
            assert earliest <= time.monotonic() - start < earliest + LATE
        leave_locked(publisher, os.getpid())
        assert subscriber.read() is None
        region_of(publisher).words[h.LOCK_HOLDER] = dead_pid()
        assert subscriber.wait(10).position.x == 2.0
        assert (region_of(publisher).words[h.RECOVERIES], value()) == (3, 1)
        assert (publisher.lock_misses, subscriber.lock_misses) == (0, 1)


@pytest.mark.usefixtures("on_arm")
def test_arm_calls_keep_their_time_limits(topic, monkeypatch):
    with (
        PosePublisher(topic) as publisher,
        PoseSubscriber(topic, lock_timeout=1) as subscriber,
        PoseSubscriber(topic, lock_timeout=0) as impatient,
    ):
        publisher.publish(pose(1))
        leave_locked(publisher, os.getpid())
        threading.Timer(0.03, PosixRelease(topic)).start()
        publisher.publish(pose(2))  # a live process holds the lock for 30 ms

        monkeypatch.setattr(lock, "_STUCK_AFTER", NEVER)
        leave_locked(publisher, os.getpid())
        publisher._end.lock.timeout = 0.05
        for call, least in (
            (lambda: publisher._end.publish(pose(3), int(1e8)), 0.1),
            (lambda: publisher.publish(pose(3)), 0.05),  # again with its own lock timeout
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
    """A call posts the semaphore, as a holder does that releases the lock."""

    def __init__(self, topic, name=None):
        self.name = "/" + (name or runtime.region_name(topic))

    def __call__(self):
        semaphore = posix_ipc.Semaphore(self.name)
        semaphore.release()
        semaphore.close()


@each_engine
def test_signal_does_not_shorten_a_wait(topic):
    """Wait for the lock, and for a sample, while signals arrive."""
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


def count_naps(call):
    """Return how often this thread slept during the call."""
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    call()
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before


@in_c
def test_waiting_reader_is_woken_and_does_not_poll(topic, other):
    writer, sequences, delays = other("publish", topic), [], []
    with PoseSubscriber(topic) as subscriber:
        for x in range(20):

            def publish_when_armed(x=x):
                until_armed(subscriber)
                writer.tell(float(x))
                sequences.append(int(writer.hear()))
                delays.append(time.monotonic())

            thread = threading.Thread(target=publish_when_armed)
            thread.start()
            assert subscriber.wait(LATE).position.x == x
            woken_at = time.monotonic()
            thread.join()
            delays[-1] = woken_at - delays[-1]
            assert region_of(subscriber).words[h.ARMED] == 0
        assert sequences == list(range(1, 21))
        assert min(delays) < 0.002, "a lost wake-up costs ten milliseconds"
        assert count_naps(lambda: subscriber.wait(0.5)) < 100


def until_armed(subscriber):
    words = region_of(subscriber).words
    until(lambda: words[h.ARMED])


@each_engine
def test_publish_wakes_only_waiting_readers(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        assert subscriber.wait(0).position.x == 1.0
        publisher.publish(pose(2))
        assert (region_of(subscriber).words[h.ARMED], region_of(subscriber).words[h.BELL]) == (0, 0)


@in_c
def test_reader_that_spins_long_enough_does_not_sleep(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic, spin=0.001) as subscriber:
        assert not subscriber.ready(0.0005)
        assert region_of(subscriber).words[h.ARMED] == 0
        assert not subscriber.ready(0.01)
        assert region_of(subscriber).words[h.ARMED] == 1
        publisher.publish(pose(1))
        assert subscriber.wait(LATE).position.x == 1.0


@pytest.mark.parametrize("spin", [-1e-6, 0.002, float("nan")])
def test_invalid_spin_is_refused(topic, spin):
    with pytest.raises(ValueError, match=r"must be from 0 to 0\.001 seconds"):
        PoseSubscriber(topic, spin=spin)


@pytest.mark.parametrize("locked", [False, True])
def test_dead_waiting_reader_does_not_affect_others(topic, locked, each_engine):
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
def test_surplus_post_does_not_make_a_reader_poll(topic, value):
    """Post like a PLC whose sample arrives between the reader's store of `armed` and its second check."""
    event = event_name(runtime.region_name(topic))
    with PoseSubscriber(topic) as subscriber:
        region_of(subscriber).words[h.WRITER] = abi.PLC
        assert subscriber.wait(0.02) is None
        PosixRelease(topic, event)()
        assert count_naps(lambda: subscriber.wait(0.5)) < 100
        assert value(event) == 0


@in_c
def test_two_waiting_readers_are_both_woken(topic):
    """Wake both readers for each sample. No reader consumes the wake-up of the other."""
    delays = []

    def read(subscriber):
        for x in range(20):
            assert subscriber.wait(LATE).position.x == x
            delays.append(time.monotonic() - published[x])

    published = {}
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as first, PoseSubscriber(topic) as second:
        threads = [threading.Thread(target=read, args=[side]) for side in (first, second)]
        for thread in threads:
            thread.start()
        for x in range(20):
            until_armed(first)
            time.sleep(0.005)
            published[x] = time.monotonic()
            publisher.publish(pose(x))
        for thread in threads:
            thread.join()
        assert first.missed == second.missed == 0
    assert sorted(delays)[len(delays) // 2] < 0.002, "a lost wake-up costs ten milliseconds"


@in_python
def test_reference_polls_every_millisecond(topic, monkeypatch):
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
def test_fence_precedes_the_check_for_waiting_readers(topic, monkeypatch):
    with PosePublisher(topic, lock_timeout=0) as publisher:
        words, fences = region_of(publisher).words, []
        monkeypatch.setattr("shmgen.runtime.reference.writer.fence", lambda: fences.append(words[h.COMPLETED0]))
        publisher.publish(pose(1))
        leave_locked(publisher, 0)
        publisher.publish(pose(2))
        assert fences == [0, 1, 1, 2], "the first fence of each call precedes the copy"


@each_engine
def test_several_waiting_readers_get_each_sample(topic, other):
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
def test_subscriber_is_stale_if_the_heartbeat_stops(topic):
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
            with PoseSubscriber(topic) as late:
                time.sleep(0.03)
                assert late.is_stale(0.02), "at the first check"
