"""An exception out of a signal handler, at any instant: the lock goes back, and the next call is as any other."""

from __future__ import annotations

import dis
import gc
import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import posix_ipc
import pytest

from shmgen import runtime
from shmgen.core.abi import REPAIR_LOCK
from shmgen.runtime.reference import lock
from shmgen.runtime.region import header as h
from shmgen.runtime.region import record_locks, resource

from ..support import machine
from ..support.plc_demo import Memory
from ..support.region_of import region_of
from ..support.tracing import traced
from .messages import PosePublisher, PoseSubscriber, pose, whole

RUNTIME = os.path.dirname(runtime.__file__)
INTERRUPTS = 300
NOT_TAKEN = dis.opmap.get("NOT_TAKEN")
"""An instruction of 3.14 that does nothing: no signal comes there, and some of them stand in no exception table."""


class Interrupt(BaseException):
    pass


def interrupted_at(step, call):
    """Calls, and raises before instruction number `step` in the runtime; True if it came to that.

    In a thread of its own: one raised where Python leaves an `except` stays for good what that thread is handling.
    """
    left = [step]

    def trace(frame, event, _):
        if not frame.f_code.co_filename.startswith(RUNTIME):
            return None
        frame.f_trace_opcodes = True
        if event == "opcode" and (NOT_TAKEN is None or frame.f_code.co_code[frame.f_lasti] != NOT_TAKEN):
            left[0] -= 1
            if left[0] == 0:
                raise Interrupt
        return trace

    def work():
        try:
            with traced(trace):
                call()
        except Interrupt:
            return True
        return False

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(work).result()


@pytest.fixture
def sides(topic, each_engine):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(0))
        yield publisher, subscriber


def healthy(publisher, subscriber, number):
    """Nobody is inside, nobody heals, and the next sample goes through."""
    region = region_of(publisher)
    assert region.semaphore.value == 1
    assert not record_locks.byte_is_locked(region.file, REPAIR_LOCK)
    misses = publisher.lock_misses, subscriber.lock_misses
    publisher.publish(pose(number))
    assert subscriber.read().position.x == number
    assert region.words[h.LOCK_HOLDER] == 0
    assert (publisher.lock_misses, subscriber.lock_misses) == misses


@pytest.mark.slow
@pytest.mark.parametrize("play", ["straight", "healing", "surplus"])
def test_an_exception_between_any_two_instructions(topic, play, monkeypatch, in_python):
    monkeypatch.setattr(lock, "_STUCK_AFTER", 0.0)
    with PosePublisher(topic, lock_timeout=0) as publisher, PoseSubscriber(topic, lock_timeout=0) as subscriber:
        publisher.publish(pose(0))

        def work():
            publisher.publish(pose(-1))
            subscriber.read()

        other, raised = posix_ipc.Semaphore("/" + runtime.region_name(topic)), 0
        for step in range(1, 10_000):
            if play == "healing":
                other.acquire(0)  # and is never seen again
            elif play == "surplus":
                for _ in range(3):
                    other.release()
            came = interrupted_at(step, work)
            raised += came
            if play == "healing" and other.value == 0:
                publisher.publish(pose(-2))  # it was interrupted before it came to healing
            if play == "surplus":
                publisher.publish(pose(-2))
            healthy(publisher, subscriber, float(step))
            if not came:
                break
        other.close()
    assert raised > 100


FLOOD = """
import posix_ipc, signal, sys
from shmgen.runtime import region_name
from tests.runtime.messages import PosePublisher, PoseSubscriber, pose
topic, side = sys.argv[1:]
publisher, subscriber = PosePublisher(topic), PoseSubscriber(topic)
semaphore = posix_ipc.Semaphore("/" + region_name(topic))
message = pose(1.0)
publisher.publish(message)

def handle(*_):
    global armed, came
    came = not armed
    if armed:
        armed = False
        raise KeyboardInterrupt

def flood():
    global armed
    armed = True
    while not came:
        if side == "read":
            subscriber._end.last = 0
            subscriber.read()
        else:
            publisher.publish(message)
    armed = False

armed = came = False
taken = interrupts = 0
signal.signal(signal.SIGINT, handle)
print("ready", flush=True)
while True:
    try:
        flood()
    except KeyboardInterrupt:
        pass
    came = False
    interrupts += 1
    taken += semaphore.value != 1
    if semaphore.value == 0:
        semaphore.release()
    print(interrupts, taken, flush=True)
"""


@pytest.mark.usefixtures("each_engine")
@pytest.mark.parametrize("side", ["publish", "read"])
@pytest.mark.family("[C-publish]", "[Python-read]")
def test_ctrl_c_at_random_instants(topic, side):
    """Real signals to a process that does nothing else: a tenth of them left the lock taken once."""
    rng = random.Random(1)
    command = [sys.executable, "-c", FLOOD, topic, side]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=os.path.dirname(RUNTIME) + "/../..")
    try:
        assert process.stdout.readline() == "ready\n"
        for number in range(1, INTERRUPTS + 1):
            time.sleep(rng.uniform(0.0002, 0.002))
            process.send_signal(signal.SIGINT)
            assert process.stdout.readline() == f"{number} 0\n"
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.usefixtures("in_python")
def test_a_call_in_which_it_happened_twice_is_made_good_by_the_next(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert publisher._end.region.semaphore.acquire()  # as where an exception came upon the giving back
        publisher.publish(pose(5))
        assert publisher.lock_misses == 0
        assert subscriber.read()
        healthy(publisher, subscriber, 6.0)


@pytest.mark.usefixtures("in_python")
@pytest.mark.parametrize("kind", [PosePublisher, PoseSubscriber])
def test_closing_gives_back_what_is_held(topic, kind):
    side = kind(topic)
    assert side._end.region.semaphore.acquire()
    side.close()
    assert region_of(topic).semaphore.value == 1


# --- one that is used while it is used ---------------------------------------------------------------------------


SAMPLES = 400


def check_all(subscriber, numbers):
    """That each has come once, and whole."""
    got = []
    for message in subscriber.read_all():
        assert whole(message)
        got.append(message.position.x)
    assert subscriber.missed == 0
    assert sorted(got) == sorted(numbers)


@pytest.fixture
def pair(topic, each_engine):
    with PosePublisher(topic, depth=4 * SAMPLES) as publisher, PoseSubscriber(topic, depth=4 * SAMPLES) as subscriber:
        yield publisher, subscriber


def test_two_threads_publish_on_one_publisher(pair):
    publisher, subscriber = pair
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(2) as threads:
            for done in [
                threads.submit(lambda first=first: [publisher.publish(pose(float(first + n))) for n in range(SAMPLES)])
                for first in (0, SAMPLES)
            ]:
                done.result()
    finally:
        sys.setswitchinterval(interval)
    check_all(subscriber, map(float, range(2 * SAMPLES)))


def test_a_signal_handler_publishes_on_the_publisher_it_interrupts(pair, each_engine):
    """In C that is safe, the reference says that it is not, and the sample that was interrupted is whole."""
    publisher, subscriber = pair
    told, sent = [], []

    def handle(*_):
        number = -1.0 - len(sent) - len(told)
        try:
            publisher.publish(pose(number))
            sent.append(number)
        except runtime.Reentered:
            told.append(number)

    former = signal.signal(signal.SIGALRM, handle)
    signal.setitimer(signal.ITIMER_REAL, 0.0005, 0.0005)
    count, end = 0, time.monotonic() + 20
    try:
        while count < SAMPLES or (len(sent) < 20 and time.monotonic() < end):
            publisher.publish(pose(float(count)))
            count += 1
            if count == 2 * SAMPLES:
                break
            time.sleep(0.0001)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)
    assert sent
    assert each_engine == "Python" or not told
    check_all(subscriber, [*map(float, range(count)), *sent])


def test_a_property_of_a_message_publishes(pair):
    """Before the region is touched."""
    publisher, subscriber = pair

    class Position:
        y = z = 1.0

        @property
        def x(self):
            publisher.publish(pose(2.0))
            return 1.0

    message = pose(1.0)
    message.position = Position()
    publisher.publish(message)
    check_all(subscriber, [2.0, 1.0])


@pytest.mark.usefixtures("in_python")
@pytest.mark.parametrize("call", [lambda publisher: publisher.publish(pose(2.0)), PosePublisher.close])
def test_the_reference_in_the_middle_of_a_copy(topic, call):
    """Is told what it cannot do, or closed; the lock is free in either case."""
    publisher, subscriber = PosePublisher(topic), PoseSubscriber(topic)
    region, told = publisher._end.region, []

    class Map:
        def __setitem__(self, where, data):
            try:
                call(publisher)
            except runtime.Reentered as error:
                told.append(str(error))
            map[where] = data

        def close(self):
            map.close()

    map, region.map = region.map, Map()
    if call is PosePublisher.close:
        with pytest.raises(runtime.Closed):
            publisher.publish(pose(1.0))
        assert subscriber.read() is None
    else:
        publisher.publish(pose(1.0))
        assert subscriber.read().position.x == 1.0
        assert told[0].startswith(f"{topic}: this publisher is called while a call of it runs")
    assert region_of(topic).semaphore.value == 1
    publisher.close()
    subscriber.close()


@pytest.mark.usefixtures("each_engine")
def test_init_called_twice_is_refused_and_the_first_goes_on(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1.0))
        for _ in range(3):
            with pytest.raises(runtime.RegionInUse):
                publisher.__init__(topic)
            publisher.publish(pose(2.0))
            assert subscriber.read().position.x == 2.0
            subscriber.__init__(topic)
            assert subscriber.read().position.x == 2.0


@pytest.mark.usefixtures("each_engine")
@pytest.mark.parametrize("held", [False, True])
def test_who_waits_is_told_when_another_thread_closes(topic, held):
    """A reader for a sample, a writer for the lock; the lock is as it was."""
    publisher, subscriber = PosePublisher(topic, lock_timeout=0.2), PoseSubscriber(topic)
    region = region_of(topic)
    if held:
        assert region.semaphore.acquire()
    side, call = (publisher, lambda: publisher.publish(pose(1))) if held else (subscriber, lambda: subscriber.wait(60))
    with ThreadPoolExecutor(1) as thread:
        waits = thread.submit(call)
        time.sleep(0.05)
        start = time.monotonic()
        side.close()
        assert time.monotonic() - start < 20
        if held:
            with nullcontext() if machine.keeps_order() else pytest.raises(runtime.LockTimeout):
                waits.result()  # on x86 it goes on without the lock; close() has waited for it
        else:
            with pytest.raises(runtime.Closed):
                waits.result()
    if held:
        region.semaphore.post()
    publisher.close()
    subscriber.close()
    assert region.semaphore.value == 1
    assert not record_locks.byte_is_locked(region.file, 0)


@pytest.mark.usefixtures("each_engine")
def test_an_interrupted_opening_keeps_no_claim(topic, monkeypatch):
    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    with PosePublisher(topic):
        memory = Memory(topic)
    memory["writer"] = 0xFFFFFFFF  # the opening waits for 1 s whether this PLC is alive
    gc.disable()
    try:
        with monkeypatch.context() as patch:
            patch.setattr(resource.time, "sleep", interrupt)
            with pytest.raises(KeyboardInterrupt):
                PosePublisher(topic)
        memory["writer"] = 0
        PosePublisher(topic).close()
    finally:
        gc.enable()
