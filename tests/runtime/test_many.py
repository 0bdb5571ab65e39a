"""One thread that waits for many topics."""

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
from shmgen.runtime.reference import bell
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
"""Nanoseconds: who is not woken from this fails by the time limit of a test."""
sleeps = pytest.mark.skipif(not runtime.can_wait_for_many(), reason="this process cannot wait for many")


class LocklessSubscriber(runtime.Subscriber):
    message_type = type("Lockless", (Pose,), {"_regions_": runtime.RegionOptions(sync="sequence")})


@pytest.fixture
def several(topic):
    """Subscribers of some topics, their events open."""
    with ExitStack() as stack:
        made = [stack.enter_context(PoseSubscriber(f"{topic}/t{number}")) for number in range(COUNT)]
        engine.sleep_any(tuple(one._end for one in made), 0)
        yield made


@pytest.fixture
def writers(topic):
    with ExitStack() as stack:
        yield [stack.enter_context(PosePublisher(f"{topic}/t{number}")) for number in range(COUNT)]


@pytest.fixture(params=["C", "Python"])
def ways(request, monkeypatch):
    """Asleep on all events, and where that cannot be."""
    if request.param == "Python":
        use_python(monkeypatch)
    elif not runtime.can_wait_for_many():
        pytest.skip("this process cannot wait for many")


def event_of(subscriber):
    """Its value, and how many wait for it; nobody where there is none."""
    if not os.path.exists(semaphore_file(event_name(region_of(subscriber).name))):
        return 0, 0
    with open(semaphore_file(event_name(region_of(subscriber).name)), "rb") as file:
        return struct.unpack("<II", file.read(8))


def at_rest(subscribers):
    """Nobody is counted as waiting for the event, and nothing is left that would end a wait early."""
    return [event_of(one) for one in subscribers] == [(0, 0)] * len(subscribers)


def dozing(subscribers):
    return all(region_of(one).words[h.ARMED] for one in subscribers)


def until(said):
    end = time.monotonic() + 60 * machine.slower
    while not said():
        assert time.monotonic() < end
        os.sched_yield()


def disarm(subscribers):
    for one in subscribers:
        region_of(one).words[h.ARMED] = 0


def ring(subscriber):
    """As a writer does that has a sample for who waits."""
    region = region_of(subscriber)
    region.words[h.ARMED] = 0
    region.words[h.BELL] += 1
    bell.ring(region.map)


def doze_all(subscribers, ns):
    """How many seconds it slept."""
    before = time.monotonic()
    engine.sleep_any(tuple(one._end for one in subscribers), ns)
    return time.monotonic() - before


@pytest.mark.usefixtures("ways")
def test_those_with_a_sample_and_no_others(several, writers):
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
    assert at_rest(several)


@sleeps
def test_any_writer_wakes_who_sleeps_and_nobody_polls(several, other, monkeypatch):
    monkeypatch.setattr(wait_any, "_SLICE", LONG / 1e9)
    processes = [other("publish", one.topic) for one in several]

    def woken(number):
        until(lambda: dozing(several))
        processes[number].tell(number)

    for number in (1, 0, 2, 2, 1):
        threading.Thread(target=woken, args=(number,)).start()
        assert ready_any(several, 600) == [several[number]]
        assert processes[number].hear()
        assert several[number].read().position.x == number
        assert at_rest(several)
        assert [region_of(one).words[h.ARMED] for one in several].count(0) == 1, "the writer has cleared it"
        disarm(several)


@sleeps
def test_a_sample_or_a_post_before_the_sleep(several, writers):
    event = Semaphore("/" + event_name(region_of(several[1]).name))
    region_of(several[1]).words[h.WRITER] = h.PLC
    event.post()
    doze_all(several, LONG)  # a post too many ends one sleep early
    assert at_rest(several)
    writers[2].publish(pose(1))
    doze_all(several, LONG)
    several[2].read()
    assert at_rest(several)


@sleeps
def test_a_plc_whose_event_is_not_there_is_looked_at_each_millisecond(several, writers, topic):
    """And nobody is kept from sleeping on the others."""
    with LocklessSubscriber(f"{topic}/lockless") as lockless:
        region_of(lockless).words[h.WRITER] = h.PLC
        for together in ((lockless,), (lockless, several[1]), (several[1], lockless)):
            assert min(doze_all(together, LONG) for _ in range(5)) < 0.1
        region_of(lockless).words[h.WRITER] = os.getpid()  # who rings
        threading.Timer(0.05, ring, [lockless]).start()
        assert doze_all((lockless, several[1]), LONG) >= 0.05
    assert at_rest(several[1:])
    # The same topic twice.
    writers[1].publish(pose(1))
    assert several[1].read()
    with PoseSubscriber(several[1].topic) as again:
        assert ready_any([again, several[1]], 0) == [again]
        assert again.read().position.x == 1.0
        assert ready_any([again, several[1]], 0.01) == []
    assert at_rest(several[1:])


@sleeps
def test_more_than_the_kernel_takes_at_once(several):
    readers = tuple(several) + tuple(PoseSubscriber(f"{several[0].topic}/t{number}") for number in range(127))
    try:
        assert ready_any(readers, 0) == []
        with PosePublisher(readers[-1].topic) as last:
            threading.Thread(target=lambda: (until(lambda: dozing(readers[:60])), last.publish(pose(1)))).start()
            assert ready_any(readers, 60) == [readers[-1]]
            assert readers[-1].read().position.x == 1.0
            assert doze_all(readers, LONG) < 10
        assert at_rest(readers)
    finally:
        for one in readers[COUNT:]:
            one.close()
    with pytest.raises(TypeError):
        engine.sleep_any((several[0]._end, 1), LONG)
    assert at_rest(several)


@sleeps
def test_one_of_them_closed_by_another_thread(several):
    """The event that is slept on stays mapped until nobody does; a region's map is gone at once."""

    def close():
        until(lambda: dozing(several))
        several[1].close()

    with ThreadPoolExecutor(1) as thread:
        closing = thread.submit(close)
        with pytest.raises(runtime.Closed):
            ready_any(several, 600)
        closing.result()
    assert event_of(several[1]) == (0, 0)
    with pytest.raises(runtime.Closed):
        ready_any(several, 600)
    others = [several[0], several[2]]
    assert ready_any(others, 0.02) == []
    assert at_rest(others)


@sleeps
def test_a_signal_ends_the_sleep_for_its_handler(several):
    came = []
    former = signal.signal(signal.SIGALRM, lambda *_: came.append(any(event_of(one)[1] for one in several)))
    signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
    try:
        doze_all(several, LONG)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)
    assert came
    assert not any(came)
    assert at_rest(several)


@sleeps
def test_one_killed_in_its_sleep_does_no_harm(several, topic, other):
    """It is counted among those who wait for a PLC's post, which then makes a system call that wakes nobody."""
    for one in several:
        region_of(one).words[h.WRITER] = h.PLC
    process = other("await", topic, COUNT).process

    def stopped_asleep():
        until(lambda: dozing(several))
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOWAIT)
        return [event_of(one) for one in several] == [(0, 1)] * COUNT or process.send_signal(signal.SIGCONT)

    until(stopped_asleep)  # arming comes before being counted
    process.kill()
    process.wait()
    for one in several:
        region_of(one).words[h.WRITER] = 0
    with ExitStack() as stack:
        writers = [stack.enter_context(PosePublisher(one.topic)) for one in several]
        for number, writer in enumerate(writers):
            writer.publish(pose(number))
        assert ready_any(several, 0) == several
        after_a_kill(several, writers)


def after_a_kill(several, writers):
    for number, one in enumerate(several):
        assert (one.read().position.x, event_of(one), region_of(one).words[h.ARMED]) == (number, (0, 1), 0)
    armed = threading.Thread(
        target=lambda: (until(lambda: region_of(several[2]).words[h.ARMED]), writers[2].publish(pose(9)))
    )
    armed.start()
    doze_all(several, LONG)
    armed.join()
    assert several[2].read().position.x == 9.0
    assert [event_of(one) for one in several] == [(0, 1)] * COUNT


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
def test_where_it_cannot_be_it_polls_and_says_so(topic, pure):
    here = runtime.can_wait_for_many()
    if not (pure or here):
        pytest.skip("this process cannot wait for many")
    command = [sys.executable, "-c", SCRIPT, topic, "38"]  # ENOSYS: as a kernel before 5.16
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
def test_a_refused_system_call_costs_nothing_or_is_named(call, error, pure, topic):
    """All works as before, but for a region that cannot get its memory."""
    command = [sys.executable, "-c", REFUSED_SCRIPT, topic, str(REFUSED[call]), str(error)]
    environment = {**os.environ, "SHMGEN_PURE": pure}
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    if call == "fallocate":
        assert re.search(r"shmgen.runtime.errors.(RegionUnusable|PermissionDenied): /dev/shm/", done.stderr)
    else:
        assert (done.stdout, done.stderr) == ("True True 1.0\n", "")
