"""An exception out of a signal handler, at any instant: the lock goes back, and the next call is as any other."""

from __future__ import annotations

import dis
import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import posix_ipc
import pytest

from shmgen import runtime
from shmgen.runtime import engine
from shmgen.runtime.reference import lock
from shmgen.runtime.reference.region import REPAIR_LOCK
from shmgen.runtime.region import header as h

from ..support.tracing import traced
from .messages import WHY_NOT, PosePublisher, PoseSubscriber, pose

RUNTIME = os.path.dirname(runtime.__file__)
INTERRUPTS = 300
NOT_TAKEN = dis.opmap.get("NOT_TAKEN")
"""An instruction of 3.14 that does nothing: no signal comes there, and some of them stand in no exception table."""
WAYS = ["Python", pytest.param("C", marks=pytest.mark.skipif(not engine.IN_C, reason=WHY_NOT))]


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


@pytest.fixture(params=WAYS)
def sides(topic, request):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        if request.param == "Python":
            publisher._disconnect()
            subscriber._disconnect()
        publisher.publish(pose(0))
        yield publisher, subscriber


def healthy(publisher, subscriber, number):
    """Nobody is inside, nobody heals, and the next sample goes through."""
    semaphore = posix_ipc.Semaphore("/" + region_of(publisher).name)
    try:
        assert semaphore.value == 1
    finally:
        semaphore.close()
    for side in (publisher, subscriber):
        assert not region_of(side).byte_is_locked(REPAIR_LOCK)
        assert not side._lock._repairing
    misses = publisher.lock_misses, subscriber.lock_misses
    publisher.publish(pose(number))
    assert subscriber.read().position.x == number
    assert region_of(publisher).words[h.LOCK_HOLDER] == 0
    assert (publisher.lock_misses, subscriber.lock_misses) == misses


@pytest.mark.parametrize("play", ["straight", "healing", "surplus"])
def test_an_exception_between_any_two_instructions(sides, play, monkeypatch):
    publisher, subscriber = sides
    monkeypatch.setattr(lock, "_STUCK_AFTER", 0.0)
    monkeypatch.setattr(lock, "_YIELDS", 1)
    publisher._lock.timeout = subscriber._lock.timeout = 0.0

    def work():
        publisher.publish(pose(-1))
        subscriber.read()

    other = posix_ipc.Semaphore("/" + region_of(publisher).name)
    raised = 0
    try:
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
    finally:
        other.close()
    assert raised > 30


FLOOD = """
import posix_ipc, signal, sys
from tests.runtime.messages import PosePublisher, PoseSubscriber, pose
topic, side, way = sys.argv[1:]
publisher, subscriber = PosePublisher(topic), PoseSubscriber(topic)
if way == "Python":
    publisher._disconnect()
    subscriber._disconnect()
semaphore = posix_ipc.Semaphore("/" + region_of(publisher).name)
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
            subscriber._last = 0
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


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("side", ["publish", "read"])
def test_ctrl_c_at_random_instants(topic, side, way):
    """Real signals to a process that does nothing else: a tenth of them left the lock taken once."""
    rng = random.Random(1)
    command = [sys.executable, "-c", FLOOD, topic, side, way]
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


def test_a_call_in_which_it_happened_twice_is_made_good_by_the_next(sides):
    publisher, subscriber = sides
    assert region_of(publisher).semaphore.acquire()  # as where an exception came upon the giving back
    healthy_after = publisher.lock_misses
    publisher.publish(pose(5))
    assert publisher.lock_misses == healthy_after
    healthy(publisher, subscriber, 6.0)


@pytest.mark.parametrize("kind", [PosePublisher, PoseSubscriber])
def test_closing_gives_back_what_is_held(topic, kind):
    side = kind(topic)
    semaphore = posix_ipc.Semaphore("/" + region_of(side).name)
    assert region_of(side).semaphore.acquire()
    side.close()
    assert semaphore.value == 1
    semaphore.close()
