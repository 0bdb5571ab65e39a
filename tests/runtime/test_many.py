"""One thread waits for many topics with ready_any()."""

from __future__ import annotations

import errno
import os
import re
import signal
import struct
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest

from shmgen import runtime
from shmgen.runtime import engine, ready_any, wait_any
from shmgen.runtime.reference import writer
from shmgen.runtime.reference.region import Semaphore
from shmgen.runtime.region import header as h
from shmgen.runtime.region.names import event_name, semaphore_file
from tests.conftest import REPOSITORY
from tests.support import machine
from tests.support.engines import use_python
from tests.support.region_of import region_of

from .messages import Pose, PosePublisher, PoseSubscriber, pose

COUNT = 3
LONG = 600 * 10**9
"""Nanoseconds. A sleeper that nobody wakes exceeds the time limit of the test."""
needs_sleep = pytest.mark.skipif(not runtime.can_wait_for_many(), reason="this process cannot wait for many")


class LocklessSubscriber(runtime.Subscriber):
    message_type = type("Lockless", (Pose,), {"_regions_": runtime.RegionOptions(sync="sequence")})


@pytest.fixture
def several(topic):
    """Subscribers of several topics, with open events."""
    with ExitStack() as stack:
        subscribers = [stack.enter_context(PoseSubscriber(f"{topic}/t{number}")) for number in range(COUNT)]
        engine.sleep_any(tuple(subscriber._end for subscriber in subscribers), 0)
        yield subscribers


@pytest.fixture
def writers(topic):
    with ExitStack() as stack:
        yield [stack.enter_context(PosePublisher(f"{topic}/t{number}")) for number in range(COUNT)]


@pytest.fixture(params=["C", "Python"])
def sleep_or_poll(request, monkeypatch):
    """Both ways to wait: a sleep on all events, and polling."""
    if request.param == "Python":
        use_python(monkeypatch)
    elif not runtime.can_wait_for_many():
        pytest.skip("this process cannot wait for many")


def read_event(subscriber):
    """Return the value of the event and its number of waiters, or zeros if the event does not exist."""
    if not os.path.exists(semaphore_file(event_name(region_of(subscriber).name))):
        return 0, 0
    with open(semaphore_file(event_name(region_of(subscriber).name)), "rb") as file:
        return struct.unpack("<II", file.read(8))


def are_idle(subscribers):
    """Return True if no event has a waiter, or a value that would end a wait early."""
    return [read_event(subscriber) for subscriber in subscribers] == [(0, 0)] * len(subscribers)


def are_armed(subscribers):
    return all(region_of(subscriber).words[h.ARMED] for subscriber in subscribers)


def until(condition):
    end = time.monotonic() + 60 * machine.slower
    while not condition():
        assert time.monotonic() < end
        os.sched_yield()


def disarm(subscribers):
    for subscriber in subscribers:
        region_of(subscriber).words[h.ARMED] = 0


def wake_reader(subscriber):
    """Wake the waiting reader, as a writer with a new sample does."""
    region = region_of(subscriber)
    region.words[h.ARMED] = 0
    region.words[h.BELL] += 1
    writer.ring(region.map)


def sleep_on_all(subscribers, ns):
    """Sleep on all subscribers, and return the duration in seconds."""
    before = time.monotonic()
    engine.sleep_any(tuple(subscriber._end for subscriber in subscribers), ns)
    return time.monotonic() - before


@pytest.mark.usefixtures("sleep_or_poll")
def test_ready_any_returns_only_subscribers_with_a_sample(several, writers):
    assert ready_any([], 0.01) == ready_any(several[:1], 0.01) == []
    writers[2].publish(pose(1))
    writers[0].publish(pose(2))
    assert ready_any(several, 0) == [several[0], several[2]]
    assert ready_any(several[2:], 60) == [several[2]]
    assert several[0].read_all()
    assert ready_any(iter(several), 60) == [several[2]]
    assert several[2].read().position.x == 1.0
    before = time.monotonic()
    assert ready_any(several, 0.03) == []
    assert time.monotonic() - before >= 0.03
    assert are_idle(several)


@needs_sleep
def test_any_writer_wakes_the_sleeping_reader(several, other, monkeypatch):
    monkeypatch.setattr(wait_any, "_SLICE", LONG / 1e9)
    processes = [other("publish", reader.topic) for reader in several]

    def publish_when_armed(number):
        until(lambda: are_armed(several))
        processes[number].tell(number)

    for number in (1, 0, 2, 2, 1):
        threading.Thread(target=publish_when_armed, args=(number,)).start()
        assert ready_any(several, 600) == [several[number]]
        assert processes[number].hear()
        assert several[number].read().position.x == number
        assert are_idle(several)
        assert [region_of(reader).words[h.ARMED] for reader in several].count(0) == 1, "the writer cleared `armed`"
        disarm(several)


@needs_sleep
def test_earlier_sample_or_post_ends_the_sleep_at_once(several, writers):
    event = Semaphore("/" + event_name(region_of(several[1]).name))
    region_of(several[1]).words[h.WRITER] = h.PLC
    event.post()
    sleep_on_all(several, LONG)  # a surplus post ends one sleep early
    assert are_idle(several)
    writers[2].publish(pose(1))
    sleep_on_all(several, LONG)
    several[2].read()
    assert are_idle(several)


@needs_sleep
def test_plc_without_an_event_is_polled_every_millisecond(several, writers, topic):
    """Sleep until the wake-up if the writer is a process instead, because a process wakes readers without an event."""
    with LocklessSubscriber(f"{topic}/lockless") as lockless:
        region_of(lockless).words[h.WRITER] = h.PLC
        for group in ((lockless,), (lockless, several[1]), (several[1], lockless)):
            assert min(sleep_on_all(group, LONG) for _ in range(5)) < 0.1
        region_of(lockless).words[h.WRITER] = os.getpid()  # a process, which wakes readers
        begin = time.monotonic()
        threading.Timer(0.05, wake_reader, [lockless]).start()
        sleep_on_all((lockless, several[1]), LONG)
        assert time.monotonic() - begin >= 0.05
    assert are_idle(several[1:])
    # One topic may occur twice.
    writers[1].publish(pose(1))
    assert several[1].read()
    with PoseSubscriber(several[1].topic) as duplicate:
        assert ready_any([duplicate, several[1]], 0) == [duplicate]
        assert duplicate.read().position.x == 1.0
        assert ready_any([duplicate, several[1]], 0.01) == []
    assert are_idle(several[1:])


@needs_sleep
def test_more_subscribers_than_the_kernel_allows_are_polled(several):
    readers = tuple(several) + tuple(PoseSubscriber(f"{several[0].topic}/t{number}") for number in range(127))
    try:
        assert ready_any(readers, 0) == []
        with PosePublisher(readers[-1].topic) as last:
            threading.Thread(target=lambda: (until(lambda: are_armed(readers[:60])), last.publish(pose(1)))).start()
            assert ready_any(readers, 60) == [readers[-1]]
            assert readers[-1].read().position.x == 1.0
            assert sleep_on_all(readers, LONG) < 10
        assert are_idle(readers)
    finally:
        for reader in readers[COUNT:]:
            reader.close()
    with pytest.raises(TypeError):
        engine.sleep_any((several[0]._end, 1), LONG)
    assert are_idle(several)


@needs_sleep
def test_close_by_another_thread_ends_ready_any(several):
    """Keep the event mapped until no thread sleeps on it. The map of the region is removed at once."""

    def close():
        until(lambda: are_armed(several))
        several[1].close()

    with ThreadPoolExecutor(1) as thread:
        future = thread.submit(close)
        with pytest.raises(runtime.Closed):
            ready_any(several, 600)
        future.result()
    assert read_event(several[1]) == (0, 0)
    with pytest.raises(runtime.Closed):
        ready_any(several, 600)
    others = [several[0], several[2]]
    assert ready_any(others, 0.02) == []
    assert are_idle(others)


@needs_sleep
def test_signal_interrupts_the_sleep_for_its_handler(several):
    waiters = []
    former = signal.signal(signal.SIGALRM, lambda *_: waiters.append(any(read_event(reader)[1] for reader in several)))
    signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
    try:
        sleep_on_all(several, LONG)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)
    assert waiters
    assert not any(waiters)
    assert are_idle(several)


@needs_sleep
def test_process_killed_in_its_sleep_does_not_affect_others(several, topic, other):
    """Count the killed process as a waiter. A PLC's post then makes a system call that wakes no process."""
    for reader in several:
        region_of(reader).words[h.WRITER] = h.PLC
    process = other("await", topic, COUNT).process

    def stop_asleep():
        until(lambda: are_armed(several))
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOWAIT)
        return [read_event(reader) for reader in several] == [(0, 1)] * COUNT or process.send_signal(signal.SIGCONT)

    until(stop_asleep)  # the process is armed before it is counted as a waiter
    process.kill()
    process.wait()
    for reader in several:
        region_of(reader).words[h.WRITER] = 0
    with ExitStack() as stack:
        writers = [stack.enter_context(PosePublisher(reader.topic)) for reader in several]
        for number, writer in enumerate(writers):
            writer.publish(pose(number))
        assert ready_any(several, 0) == several
        check_after_kill(several, writers)


def check_after_kill(several, writers):
    for number, reader in enumerate(several):
        assert (reader.read().position.x, read_event(reader), region_of(reader).words[h.ARMED]) == (number, (0, 1), 0)
    thread = threading.Thread(
        target=lambda: (until(lambda: region_of(several[2]).words[h.ARMED]), writers[2].publish(pose(9)))
    )
    thread.start()
    sleep_on_all(several, LONG)
    thread.join()
    assert several[2].read().position.x == 9.0
    assert [read_event(reader) for reader in several] == [(0, 1)] * COUNT


SCRIPT = """
import os, sys, threading
from shmgen.runtime import can_wait_for_many, ready_any
from shmgen.runtime import engine
from tests.runtime.messages import PosePublisher, PoseSubscriber, pose
from tests.support import seccomp
from tests.support.region_of import region_of

print(can_wait_for_many())
if os.environ.get("SHMGEN_PURE") != "1":
    seccomp.forbid(449, int(sys.argv[2]))
    print(can_wait_for_many())
topic = sys.argv[1]
with PoseSubscriber(topic) as first, PoseSubscriber(topic + "/second") as second, PosePublisher(topic) as writer:
    assert ready_any([second, first], 0.01) == []
    threading.Timer(0.02, lambda: writer.publish(pose(1))).start()
    assert ready_any([second, first], 60) == [first]
"""


@pytest.mark.skipif(machine.EMULATED, reason="qemu-user has no seccomp")
@pytest.mark.parametrize("pure", [False, True], ids=["forbidden", "pure"])
def test_ready_any_polls_if_it_cannot_sleep(topic, pure):
    can_sleep = runtime.can_wait_for_many()
    if not (pure or can_sleep):
        pytest.skip("this process cannot wait for many")
    command = [sys.executable, "-c", SCRIPT, topic, "38"]  # ENOSYS, like a kernel before 5.16
    environment = {**os.environ, "SHMGEN_PURE": "1" if pure else ""}
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == (["False"] if pure else ["True", "False"])


REFUSED_SCRIPT = """
import select, sys, threading
from shmgen.runtime import Notifier, ready_any
from tests.runtime.messages import PosePublisher, PoseSubscriber, pose
from tests.support import seccomp

seccomp.forbid(int(sys.argv[2]), int(sys.argv[3]))
topic = sys.argv[1]
with PoseSubscriber(topic) as first, PoseSubscriber(topic + "/second") as second, PosePublisher(topic) as writer:
    with Notifier([first, second]) as notifier:
        threading.Timer(0.02, lambda: writer.publish(pose(1))).start()
        select.select([notifier], [], [], 60)
        print(notifier.ready() == [first], ready_any([second, first], 60) == [first], first.wait(60).position.x)
"""
REFUSED = {"futex_waitv": 449, "membarrier": 324, "memfd_create": 319, "fallocate": 285}
"""Numbers of system calls on x86-64 that old kernels lack, and that sandboxes refuse."""


@pytest.mark.skipif(machine.EMULATED or os.uname().machine != "x86_64", reason="these are the numbers of x86-64")
@pytest.mark.parametrize("pure", ["", "1"], ids=["C", "Python"])
@pytest.mark.parametrize("error", [errno.ENOSYS, errno.EPERM], ids=["ENOSYS", "EPERM"])
@pytest.mark.parametrize("call", REFUSED)
def test_refused_system_call_is_tolerated_or_reported(call, error, pure, topic):
    """Wait without the refused system call. Only a region that cannot allocate its memory raises an error."""
    command = [sys.executable, "-c", REFUSED_SCRIPT, topic, str(REFUSED[call]), str(error)]
    environment = {**os.environ, "SHMGEN_PURE": pure}
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    if call == "fallocate":
        assert re.search(r"shmgen.runtime.errors.(RegionUnusable|PermissionDenied): /dev/shm/", done.stderr)
    else:
        assert (done.stdout, done.stderr) == ("True True 1.0\n", "")
