"""An exception from a signal handler, at any instant, releases the lock and does not affect the next call."""

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
from .messages import PosePublisher, PoseSubscriber, is_whole, pose

RUNTIME = os.path.dirname(runtime.__file__)
INTERRUPTS = 300
NOT_TAKEN = dis.opmap.get("NOT_TAKEN")
"""An instruction of Python 3.14 that does nothing. No signal is handled there, and exception tables may omit it."""


class Interrupt(BaseException):
    pass


def interrupt_at(step, call):
    """Run `call`, and raise before instruction number `step` in the runtime. Return True if `call` reached the step.

    Use a new thread: an exception at the end of an `except` block remains the handled exception of its thread for good.
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

    def run():
        try:
            with traced(trace):
                call()
        except Interrupt:
            return True
        return False

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(run).result()


def check_health(publisher, subscriber, number):
    """Check that the lock is free, that nobody repairs the lock, and that the next sample arrives."""
    region = region_of(publisher)
    assert region.semaphore.value == 1
    assert not record_locks.byte_is_locked(region.file, REPAIR_LOCK)
    misses = publisher.lock_misses, subscriber.lock_misses
    publisher.publish(pose(number))
    assert subscriber.read().position.x == number
    assert region.words[h.LOCK_HOLDER] == 0
    assert (publisher.lock_misses, subscriber.lock_misses) == misses


@pytest.mark.sample("[straight]")
@pytest.mark.parametrize("scenario", ["straight", "healing", "surplus"])
def test_exception_between_any_two_instructions_releases_the_lock(topic, scenario, monkeypatch, in_python):
    monkeypatch.setattr(lock, "_STUCK_AFTER", 0.0)
    with PosePublisher(topic, lock_timeout=0) as publisher, PoseSubscriber(topic, lock_timeout=0) as subscriber:
        publisher.publish(pose(0))

        def publish_and_read():
            publisher.publish(pose(-1))
            subscriber.read()

        other, raised = posix_ipc.Semaphore("/" + runtime.region_name(topic)), 0
        for step in range(1, 10_000):
            if scenario == "healing":
                other.acquire(0)  # and its holder disappears
            elif scenario == "surplus":
                for _ in range(3):
                    other.release()
            interrupted = interrupt_at(step, publish_and_read)
            raised += interrupted
            if scenario == "healing" and other.value == 0:
                publisher.publish(pose(-2))  # the interrupt came before the recovery of the lock
            if scenario == "surplus":
                publisher.publish(pose(-2))
            check_health(publisher, subscriber, float(step))
            if not interrupted:
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
def test_ctrl_c_at_random_instants_releases_the_lock(topic, side):
    """Send real signals to a process that only publishes or only reads."""
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
def test_next_call_releases_a_lock_left_by_an_interrupted_call(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert publisher._end.region.semaphore.acquire()  # as after an exception during the release
        publisher.publish(pose(5))
        assert publisher.lock_misses == 0
        assert subscriber.read()
        check_health(publisher, subscriber, 6.0)


@pytest.mark.usefixtures("in_python")
@pytest.mark.parametrize("kind", [PosePublisher, PoseSubscriber])
def test_close_releases_a_lock_left_by_an_interrupted_call(topic, kind):
    side = kind(topic)
    assert side._end.region.semaphore.acquire()
    side.close()
    assert region_of(topic).semaphore.value == 1


# --- calls during a call of the same endpoint ---------------------------------------------------------------------


SAMPLES = 400


def check_all(subscriber, numbers):
    """Check that each sample arrived once and complete."""
    positions = []
    for message in subscriber.read_all():
        assert is_whole(message)
        positions.append(message.position.x)
    assert subscriber.missed == 0
    assert sorted(positions) == sorted(numbers)


@pytest.fixture
def pair(topic, each_engine):
    with PosePublisher(topic, depth=4 * SAMPLES) as publisher, PoseSubscriber(topic, depth=4 * SAMPLES) as subscriber:
        yield publisher, subscriber


def test_two_threads_may_share_a_publisher(pair):
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


def test_signal_handler_may_publish_during_a_publish(pair, each_engine):
    """Publish in C, and raise Reentered in the reference. The interrupted sample remains complete."""
    publisher, subscriber = pair
    rejected, sent = [], []

    def handle(*_):
        number = -1.0 - len(sent) - len(rejected)
        try:
            publisher.publish(pose(number))
            sent.append(number)
        except runtime.Reentered:
            rejected.append(number)

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
    assert each_engine == "Python" or not rejected
    check_all(subscriber, [*map(float, range(count)), *sent])


def test_property_of_a_message_may_publish(pair):
    """Evaluate the property before the publisher writes into the region."""
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
def test_reference_refuses_to_publish_or_closes_during_a_copy(topic, call):
    """Raise Reentered, or close the publisher. The lock is free in either case."""
    publisher, subscriber = PosePublisher(topic), PoseSubscriber(topic)
    region, errors = publisher._end.region, []

    class Map:
        def __setitem__(self, key, data):
            try:
                call(publisher)
            except runtime.Reentered as error:
                errors.append(str(error))
            map[key] = data

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
        assert errors[0].startswith(f"{topic}: this publisher was called during another call")
    assert region_of(topic).semaphore.value == 1
    publisher.close()
    subscriber.close()


@pytest.mark.usefixtures("each_engine")
def test_second_init_call_keeps_the_endpoint_usable(topic):
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
@pytest.mark.parametrize("busy", [False, True])
def test_close_by_another_thread_ends_a_waiting_call(topic, busy):
    """Close a reader that waits for a sample, or a writer that waits for the lock. The lock remains unchanged."""
    publisher, subscriber = PosePublisher(topic, lock_timeout=0.2), PoseSubscriber(topic)
    region = region_of(topic)
    if busy:
        assert region.semaphore.acquire()
    side, call = (publisher, lambda: publisher.publish(pose(1))) if busy else (subscriber, lambda: subscriber.wait(60))
    with ThreadPoolExecutor(1) as thread:
        waits = thread.submit(call)
        time.sleep(0.05)
        start = time.monotonic()
        side.close()
        assert time.monotonic() - start < 20
        if busy:
            with nullcontext() if machine.keeps_order() else pytest.raises(runtime.LockTimeout):
                waits.result()  # on x86 it continues without the lock, and close() waits for it
        else:
            with pytest.raises(runtime.Closed):
                waits.result()
    if busy:
        region.semaphore.post()
    publisher.close()
    subscriber.close()
    assert region.semaphore.value == 1
    assert not record_locks.byte_is_locked(region.file, 0)


@pytest.mark.usefixtures("each_engine")
def test_interrupted_opening_keeps_no_claim(topic, monkeypatch):
    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    with PosePublisher(topic):
        memory = Memory(topic)
    memory["writer"] = 0xFFFFFFFF  # the opening watches the heartbeat of this PLC for 1 s
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
