"""Writers that change over: whoever has lost a topic writes nothing more and is told, and nothing torn is accepted.

The PLC runs here, and its clock stands still but for what a test adds to it; a Python that stops half-way is a process
of its own, stopped by a real signal. The letters are those of the faults that were found.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import ModuleType
from typing import Any

import pytest

from shmgen.core.model import TypeName
from shmgen.runtime import ClaimLost, LayoutMismatch, RegionInUse
from shmgen.runtime.reference import lock
from shmgen.runtime.reference.claim import WATCHED
from shmgen.runtime.region import header
from tests.support.engines import in_python, use_python
from tests.support.region_of import region_of

from ..conftest import REPOSITORY
from ..softplc import Block
from ..support.build import module
from ..support.plc_calls import PACKAGE, Calls
from ..support.plc_demo import CLAIM, CONFIRM, HEAL, SLOTS, Clock, Demo, Memory, ready, semaphore

LOST, TORN = 7, 8
"""Exit codes of a process: it was told that it had lost the topic; anything else."""


@contextmanager
def forked(work: Callable[[], None]) -> Iterator[int]:
    """A process that does `work`, and stops itself somewhere in it; the block begins once it has."""
    pid = os.fork()
    if pid == 0:
        code = TORN
        try:
            work()
        except ClaimLost:
            code = LOST
        finally:
            os._exit(code)
    try:
        assert os.WIFSTOPPED(os.waitpid(pid, os.WUNTRACED)[1])
        yield pid
    finally:
        with suppress(ProcessLookupError):  # it has ended
            os.kill(pid, signal.SIGKILL)


def going_on(pid: int) -> int:
    """Lets it go on until it ends, and returns its exit code."""
    os.kill(pid, signal.SIGCONT)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


class Halves:
    """A region's map into which a copy goes in two halves, and the process stands still between them."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def close(self) -> None:
        self.inner.close()

    def __setitem__(self, where: slice, data: bytes) -> None:
        middle = where.start + (where.stop - where.start) // 2
        self.inner[where.start : middle] = data[: middle - where.start]
        os.kill(os.getpid(), signal.SIGSTOP)
        self.inner[middle : where.stop] = data[middle - where.start :]


def python_stops_in_its_copy(demo: Demo, topic: str) -> Callable[[], None]:
    def work() -> None:
        with in_python(), demo.python.DemoPublisher(topic) as publisher:
            publisher.publish(demo.message(1))
            publisher._end.region.map = Halves(publisher._end.region.map)
            publisher.publish(demo.message(2))

    return work


def whole(message: Any) -> bool:
    return bool(message.b == 2 * message.a and message.label in (f"x{message.a % 1000}", "hey"))


def seen(demo: Demo, topic: str) -> int | None:
    """What a reader that comes now gets, which is whole."""
    with demo.python.DemoSubscriber(topic) as subscriber:
        message = subscriber.read()
        assert message is None or whole(message)
        return None if message is None else message.a


def passes(clock: Clock, block: Block, ms: int) -> None:
    for _ in range(ms // 50):
        clock.add(50)
        block()


def says(block: Block, number: int) -> Block:
    block.Msg.a, block.Msg.b = number, 2 * number
    return block


@pytest.fixture
def srv(compiled_calls: Calls) -> ModuleType:
    return module(compiled_calls.folder, PACKAGE, TypeName("calls_msgs", "srv", "Ask"))


# --- a: one of them stops inside its copy -------------------------------------------------------------


def test_python_stops_in_its_copy_and_a_plc_takes_over(demo: Demo, clock: Clock, topic: str) -> None:
    with forked(python_stops_in_its_copy(demo, topic)) as pid:
        block = says(demo.publisher(topic), 20)()
        assert seen(demo, topic) == 1
        passes(clock, block, HEAL + CLAIM + CONFIRM + 200)
        assert (block.xSent, block.eErrorID) == (True, "NO_ERROR")
        assert seen(demo, topic) == 20
        # The late half goes into a slot, and under a number, that the new writer has left alone.
        assert block.udiSequence > 2 + SLOTS
        with demo.python.DemoSubscriber(topic) as subscriber:
            subscriber.read()
            assert going_on(pid) == LOST
            assert subscriber.read() is None
        for number in range(21, 26):
            assert says(block, number)().xSent
            assert seen(demo, topic) == number
    assert semaphore(topic).value == 1


def test_a_plc_stops_between_begin_and_end_and_python_takes_over(demo: Demo, clock: Clock, topic: str) -> None:
    block = says(demo.opened(topic), 0)()
    before = block.udiSequence
    plc = block._fbRegion
    place = plc.method("BeginWrite")
    assert place
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(20))
        assert publisher.sequence in (before + 2, before + 3)
        assert seen(demo, topic) == 20
        ctypes.memset(place, 1, 1)  # the rest of its copy, into its own lane
        assert plc.method("EndWrite") is False
        assert (plc.xReady, plc.eErrorID) == (False, "WRITER_IN_USE")
        assert seen(demo, topic) == 20
        for number in range(21, 26):
            publisher.publish(demo.message(number))
            block()
            assert (seen(demo, topic), block.xSent) == (number, False)


def test_a_plc_that_lost_the_topic_within_its_cycle_begins_no_sample(demo: Demo, topic: str) -> None:
    plc, memory = demo.opened(topic)._fbRegion, Memory(topic)
    memory["writer"], before = os.getppid(), memory.bytes()[192:]
    assert plc.method("BeginWrite") == 0
    assert (plc.xReady, plc.eErrorID, memory.bytes()[192:]) == (False, "WRITER_IN_USE", before)
    assert semaphore(topic).value == 1


@pytest.mark.parametrize(("word", "value"), [("writer", 4242), ("heartbeat", 4242)])
def test_a_plc_whose_topic_another_beats_for_counts_no_heartbeat(demo: Demo, topic: str, word: str, value: int) -> None:
    block = ready(demo.publisher(topic, xSend=False))
    assert block._fbRegion.xReady
    memory = Memory(topic)
    memory[word] = value
    heartbeat = memory["heartbeat"]
    assert (block().eErrorID, memory["heartbeat"]) == ("WRITER_IN_USE", heartbeat)


# --- b, g: calls --------------------------------------------------------------------------------------


def test_a_client_that_was_idle_takes_no_answer_of_another(calls: Calls, srv: ModuleType, topic: str) -> None:
    with srv.AskServer(topic) as server, srv.AskClient(topic) as idle:
        number = idle.send(srv.Ask_Request(question=1))
        server.reply(server.take(), srv.Ask_Response(answer=4))
        assert idle.poll().answer == 4
        other = ready(calls.client(topic), CLAIM)
        other.Request.question = 5
        other(xExecute=True)
        call = server.take()
        assert (other.udiCall, call.number, call.request.question) == (number + 2, number + 2, 5)
        with pytest.raises(ClaimLost, match="a PLC has taken the topic over"):
            idle.send(srv.Ask_Request(question=7))
        server.reply(call, srv.Ask_Response(answer=16))
        assert idle.poll() is None
        assert (other().xDone, other.Response.answer) == (True, 16)


def test_a_server_that_was_replaced_hands_out_no_call(calls: Calls, srv: ModuleType, topic: str) -> None:
    with srv.AskServer(topic) as old, srv.AskClient(topic) as client:
        new = ready(calls.server(topic), CLAIM)
        client._calls.send_request(srv.Ask_Request(question=5))
        assert (new().xExecute, new.Request.question) == (True, 5)
        with pytest.raises(ClaimLost):
            old.take()
        with pytest.raises(ClaimLost):
            old.wait(0.1)


def test_a_plc_that_was_replaced_within_its_cycle_takes_no_call(calls: Calls, srv: ModuleType, topic: str) -> None:
    server = ready(calls.server(topic))
    with srv.AskClient(topic) as client:
        for owner, taken in ((4242, False), (header.PLC, True)):
            client._calls.send_request(srv.Ask_Request(question=5))
            server._fbServer.method("Cycle", iJob=0, xProgressReady=True, eProgressError="NO_ERROR")
            Memory(topic, "-response")["writer"] = owner
            assert server._fbServer.method("BeginTake")
            assert server._fbServer.method("EndTake", udiCancel=0) == taken
            Memory(topic, "-response")["writer"] = header.PLC


def test_a_call_that_a_former_server_has_taken_is_not_taken_again(
    srv: ModuleType, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the lock is needed, and somebody holds that of the request while the server starts anew."""
    monkeypatch.setattr(lock, "keeps_order", lambda: False)
    with srv.AskClient(topic) as client:
        with srv.AskServer(topic) as first:
            client.send(srv.Ask_Request(question=5))
            assert first.take().request.question == 5
        request = semaphore(topic, "-request")
        request.acquire(0)
        with srv.AskServer(topic) as second:
            request.release()
            assert second.take() is None
            client.send(srv.Ask_Request(question=6))
            assert second.take().request.question == 6


# --- c, d, f: claims ----------------------------------------------------------------------------------


def test_an_idle_writer_loses_the_topic_and_is_told(demo: Demo, clock: Clock, topic: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher, demo.python.DemoSubscriber(topic) as subscriber:
        publisher.publish(demo.message(1))
        block = says(ready(demo.publisher(topic), CLAIM), 20)
        numbers, both = [], 0
        for _ in range(10):  # in step with the PLC, so that both count the heartbeat up alike
            wrote = True
            try:
                publisher.publish(demo.message(2))
            except ClaimLost:
                wrote = False
            both += wrote and block().xSent
            numbers += [number for number, *_ in subscriber.samples()]
            clock.add(1)
            block()
        assert (both, wrote, block.eErrorID) == (0, False, "NO_ERROR")
        assert numbers == sorted(set(numbers))
        for call in (publisher.heartbeat, lambda: publisher.publish(demo.message(3))):
            with pytest.raises(ClaimLost):
                call()
        with pytest.raises(RegionInUse, match="a PLC publishes already"):  # its record lock went with its claim
            runs_while(block, lambda: demo.python.DemoPublisher(topic).close())


def runs_while(block: Block, call: Callable[[], object]) -> None:
    """The task of the PLC, 1 ms a cycle, in a thread of its own."""
    over = threading.Event()

    def run() -> None:
        while not over.is_set():
            block.run(0.001, 10)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        call()
    finally:
        over.set()
        thread.join()


def test_close_clears_only_its_own_claim(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    with demo.python.DemoPublisher(topic) as publisher:
        block._fbRegion.method("Close")
        assert Memory(topic)["writer"] == os.getpid()
        publisher.publish(demo.message(1))
        again = demo.publisher(topic)()
        assert (again.xBusy, again.xSent) == (True, False)  # it watches


def test_a_number_left_out_is_not_forgotten_by_close(demo: Demo, clock: Clock, topic: str) -> None:
    """The one whose number it is may still write; so the next must leave it out as well."""
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        block = demo.publisher(topic, xSend=False)
        ready(block, CLAIM)
        assert block._fbRegion.xReady
        block(xEnable=False)
        assert Memory(topic)["writer"] == 0
        assert ready(demo.publisher(topic, xSend=False), CLAIM)._fbRegion._udiLast == 2
        with pytest.raises(ClaimLost):
            publisher.publish(demo.message(2))


@pytest.mark.slow
def test_a_plc_with_a_slow_task_keeps_its_topic(compiled_demo: Demo, topic: str) -> None:
    """A cycle of 200 ms, in a process of its own."""
    task = ["-m", "tests.softplc.task", str(compiled_demo.library), "FB_demo_msgs_Demo_Publisher", "--period", "0.2"]
    command = [sys.executable, *task, "--set", "xEnable=true", f'sTopic="{topic}"']
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=REPOSITORY) as plc:
        try:
            assert plc.stdout
            assert plc.stdout.readline() == "running\n"
            while not Memory(topic)["completed0"]:
                time.sleep(0.01)
            for _ in range(5):
                with pytest.raises(RegionInUse):
                    compiled_demo.python.DemoPublisher(topic)
                time.sleep(0.07)
        finally:
            plc.kill()


def test_of_two_that_claim_at_once_one_writes(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.publisher(topic)()
    block()
    assert Memory(topic)["writer"] == header.PLC  # its name stands there, and nothing more
    clock.add(CONFIRM - 1)
    assert block().xBusy
    with demo.python.DemoPublisher(topic) as publisher:  # sees no sign of life, and puts its name over it
        clock.add(1)
        assert (block().xSent, block.eErrorID) == (False, "WRITER_IN_USE")
        publisher.publish(demo.message(1))
    assert WATCHED * 1000 == CLAIM


def test_who_claims_while_a_plc_watches_is_watched_anew(demo: Demo, clock: Clock, topic: str) -> None:
    demo.python.DemoSubscriber(topic).close()
    memory = Memory(topic)
    memory["writer"] = 4241
    block = demo.publisher(topic)()
    clock.add(CLAIM - 1)
    memory["writer"] = 4242
    block()
    clock.add(CLAIM - 1)
    block()
    assert memory["writer"] == 4242
    clock.add(1)
    block()
    assert memory["writer"] == header.PLC


def test_python_that_claims_over_a_claim_gives_way(demo: Demo, topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A PLC puts its name there while Python waits whether its own stands."""
    demo.opened(topic)
    memory, sleep = Memory(topic), time.sleep

    def slept(seconds: float) -> None:
        if memory["writer"] == os.getpid():
            memory["writer"] = header.PLC
        sleep(seconds)

    monkeypatch.setattr(time, "sleep", slept)
    with pytest.raises(RegionInUse, match="a PLC publishes already"):
        demo.python.DemoPublisher(topic)


# --- e, h: the semaphore, the lock, the header ----------------------------------------------------------


@pytest.mark.parametrize("who", ["Python", "PLC"])
def test_a_semaphore_that_was_taken_before_its_maker_came_to_it(demo: Demo, clock: Clock, topic: str, who: str) -> None:
    demo.plc.born(1)
    demo.plc.fail("SysSemProcessEnter", 5)  # somebody is inside
    block = demo.publisher(topic)()
    demo.plc.fail("", 0)
    assert (semaphore(topic).value, Memory(topic)["recoveries"]) == (2, 1)
    if who == "PLC":
        ready(block)
    else:
        with demo.python.DemoPublisher(topic) as publisher:
            publisher.publish(demo.message(1))
    assert semaphore(topic).value == 1


def test_a_lock_that_was_free_meanwhile_is_not_stuck(demo: Demo, topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one inside now has not counted yet, so that `lock_count` is as it was."""
    use_python(monkeypatch)
    monkeypatch.setattr(lock, "_STUCK_AFTER", 0.2)
    with demo.python.DemoPublisher(topic) as publisher:
        held, memory = semaphore(topic), Memory(topic)
        held.acquire(0)
        memory["lock_count"], memory["lock_holder"] = memory["lock_count"] + 1, os.getppid()
        publisher.publish(demo.message(1))
        assert publisher.lock_misses == 1
        memory["lock_holder"] = 0
        held.release()
        time.sleep(0.3)
        held.acquire(0)
        publisher.publish(demo.message(2))
        assert (publisher.lock_misses, memory["recoveries"]) == (2, 0)


def test_a_plc_takes_no_lock_for_stuck_that_was_free_meanwhile(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.opened(topic)
    held, memory = semaphore(topic), Memory(topic)
    held.acquire(0)
    memory["lock_count"], memory["lock_holder"] = memory["lock_count"] + 1, os.getppid()
    block()
    memory["lock_holder"] = 0
    clock.add(HEAL)
    block()
    assert memory["recoveries"] == 0


def test_a_header_written_over_by_another_maker(demo: Demo, topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    block = demo.publisher(topic)()
    Memory(topic).poke(8, b"\x99")
    block()
    ready(block)
    assert block.eErrorID == "DIGEST_MISMATCH"

    other, sleep = f"{topic}/python", time.sleep

    def slept(seconds: float) -> None:
        with suppress(FileNotFoundError, ValueError):
            if region_of(other).words[0]:  # its header is there, and waits for another maker of it
                Memory(other).poke(8, b"\x99")
        sleep(seconds)

    monkeypatch.setattr(time, "sleep", slept)
    with pytest.raises(LayoutMismatch):
        demo.python.DemoSubscriber(other)
