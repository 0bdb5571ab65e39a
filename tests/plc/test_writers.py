"""A writer that has lost its topic writes nothing more and reports an error. No reader accepts a torn sample.

The PLC runs in this process, and its clock changes only when a test advances it. A Python writer that stops in its copy
is a child process, which a real signal stops.
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
"""Exit codes of a child process: ClaimLost was raised, or anything else happened."""


@contextmanager
def fork_stopped(work: Callable[[], None]) -> Iterator[int]:
    """Execute `work` in a child process, which stops itself, and enter the `with` block once the child has stopped."""
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
        with suppress(ProcessLookupError):  # the child has ended
            os.kill(pid, signal.SIGKILL)


def resume(pid: int) -> int:
    """Resume the child process, wait for its end, and return its exit code."""
    os.kill(pid, signal.SIGCONT)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


class StoppingMap:
    """The mapped memory of a region. Data is copied in two halves, and the process stops between them."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def close(self) -> None:
        self.inner.close()

    def __setitem__(self, target: slice, data: bytes) -> None:
        middle = target.start + (target.stop - target.start) // 2
        self.inner[target.start : middle] = data[: middle - target.start]
        os.kill(os.getpid(), signal.SIGSTOP)
        self.inner[middle : target.stop] = data[middle - target.start :]


def make_stopping_publisher(demo: Demo, topic: str) -> Callable[[], None]:
    def work() -> None:
        with in_python(), demo.python.DemoPublisher(topic) as publisher:
            publisher.publish(demo.message(1))
            publisher._end.region.map = StoppingMap(publisher._end.region.map)
            publisher.publish(demo.message(2))

    return work


def is_whole(message: Any) -> bool:
    return bool(message.b == 2 * message.a and message.label in (f"x{message.a % 1000}", "hey"))


def read_newest(demo: Demo, topic: str) -> int | None:
    """Return the value that a new reader gets, and fail if its sample is torn."""
    with demo.python.DemoSubscriber(topic) as subscriber:
        message = subscriber.read()
        assert message is None or is_whole(message)
        return None if message is None else message.a


def run_cycles(clock: Clock, block: Block, ms: int) -> None:
    for _ in range(ms // 50):
        clock.add(50)
        block()


def set_message(block: Block, number: int) -> Block:
    block.Msg.a, block.Msg.b = number, 2 * number
    return block


@pytest.fixture
def srv(compiled_calls: Calls) -> ModuleType:
    return module(compiled_calls.folder, PACKAGE, TypeName("calls_msgs", "srv", "Ask"))


# --- a writer stops in its copy -----------------------------------------------------------------------


def test_plc_takes_over_from_python_stopped_in_its_copy(demo: Demo, clock: Clock, topic: str) -> None:
    with fork_stopped(make_stopping_publisher(demo, topic)) as pid:
        block = set_message(demo.publisher(topic), 20)()
        assert read_newest(demo, topic) == 1
        run_cycles(clock, block, HEAL + CLAIM + CONFIRM + 200)
        assert (block.xSent, block.eErrorID) == (True, "NO_ERROR")
        assert read_newest(demo, topic) == 20
        # The second half goes into a slot and under a number that the new writer skips.
        assert block.udiSequence > 2 + SLOTS
        with demo.python.DemoSubscriber(topic) as subscriber:
            subscriber.read()
            assert resume(pid) == LOST
            assert subscriber.read() is None
        for number in range(21, 26):
            assert set_message(block, number)().xSent
            assert read_newest(demo, topic) == number
    assert semaphore(topic).value == 1


def test_python_takes_over_from_a_plc_stopped_in_a_write(demo: Demo, clock: Clock, topic: str) -> None:
    block = set_message(demo.opened(topic), 0)()
    before = block.udiSequence
    plc = block._fbRegion
    place = plc.method("BeginWrite")
    assert place
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(20))
        assert publisher.sequence in (before + 2, before + 3)
        assert read_newest(demo, topic) == 20
        ctypes.memset(place, 1, 1)  # the rest of its copy, into its own lane
        assert plc.method("EndWrite") is False
        assert (plc.xReady, plc.eErrorID) == (False, "WRITER_IN_USE")
        assert read_newest(demo, topic) == 20
        for number in range(21, 26):
            publisher.publish(demo.message(number))
            block()
            assert (read_newest(demo, topic), block.xSent) == (number, False)


def test_plc_begins_no_sample_after_it_lost_the_topic(demo: Demo, topic: str) -> None:
    plc, memory = demo.opened(topic)._fbRegion, Memory(topic)
    memory["writer"], before = os.getppid(), memory.bytes()[192:]
    assert plc.method("BeginWrite") == 0
    assert (plc.xReady, plc.eErrorID, memory.bytes()[192:]) == (False, "WRITER_IN_USE", before)
    assert semaphore(topic).value == 1


@pytest.mark.parametrize(("word", "value"), [("writer", 4242), ("heartbeat", 4242)])
def test_plc_sends_no_heartbeat_after_it_lost_the_topic(demo: Demo, topic: str, word: str, value: int) -> None:
    block = ready(demo.publisher(topic, xSend=False))
    assert block._fbRegion.xReady
    memory = Memory(topic)
    memory[word] = value
    heartbeat = memory["heartbeat"]
    assert (block().eErrorID, memory["heartbeat"]) == ("WRITER_IN_USE", heartbeat)


# --- calls --------------------------------------------------------------------------------------------


def test_idle_client_gets_no_response_of_another(calls: Calls, srv: ModuleType, topic: str) -> None:
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


def test_replaced_python_server_returns_no_call(calls: Calls, srv: ModuleType, topic: str) -> None:
    with srv.AskServer(topic) as old, srv.AskClient(topic) as client:
        new = ready(calls.server(topic), CLAIM)
        client._calls.send_request(srv.Ask_Request(question=5))
        assert (new().xExecute, new.Request.question) == (True, 5)
        with pytest.raises(ClaimLost):
            old.take()
        with pytest.raises(ClaimLost):
            old.wait(0.1)


def test_replaced_plc_server_takes_no_call(calls: Calls, srv: ModuleType, topic: str) -> None:
    server = ready(calls.server(topic))
    with srv.AskClient(topic) as client:
        for owner, is_taken in ((4242, False), (header.PLC, True)):
            client._calls.send_request(srv.Ask_Request(question=5))
            server._fbServer.method("Cycle", iJob=0, xProgressReady=True, eProgressError="NO_ERROR")
            Memory(topic, "-response")["writer"] = owner
            assert server._fbServer.method("BeginTake")
            assert server._fbServer.method("EndTake", udiCancel=0) == is_taken
            Memory(topic, "-response")["writer"] = header.PLC


def test_call_that_a_former_server_took_is_not_repeated(
    srv: ModuleType, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Start the next server while the request's lock is held, on a machine that needs the lock."""
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


# --- claims -------------------------------------------------------------------------------------------


def test_idle_publisher_loses_the_topic_and_raises(demo: Demo, clock: Clock, topic: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher, demo.python.DemoSubscriber(topic) as subscriber:
        publisher.publish(demo.message(1))
        block = set_message(ready(demo.publisher(topic), CLAIM), 20)
        numbers, both = [], 0
        for _ in range(10):  # in step with the PLC, so that both increase the heartbeat alike
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
        with pytest.raises(RegionInUse, match="a PLC publishes already"):  # the record lock was released with the claim
            run_plc_during(block, lambda: demo.python.DemoPublisher(topic).close())


def run_plc_during(block: Block, call: Callable[[], object]) -> None:
    """Execute `call` while a thread runs the task of the PLC with a cycle of 1 ms."""
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


def test_close_releases_only_its_own_claim(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    with demo.python.DemoPublisher(topic) as publisher:
        block._fbRegion.method("Close")
        assert Memory(topic)["writer"] == os.getpid()
        publisher.publish(demo.message(1))
        again = demo.publisher(topic)()
        assert (again.xBusy, again.xSent) == (True, False)  # the block watches the topic


def test_next_writer_also_skips_the_reserved_number(demo: Demo, clock: Clock, topic: str) -> None:
    """Skip the sample number that a stopped writer reserved, because this writer may still write it."""
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
def test_plc_with_a_slow_task_keeps_its_topic(compiled_demo: Demo, topic: str) -> None:
    """Run the PLC in a separate process with a cycle of 200 ms."""
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


def test_only_one_of_two_claims_at_once_writes(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.publisher(topic)()
    block()
    assert Memory(topic)["writer"] == header.PLC  # the name is written, and nothing more
    clock.add(CONFIRM - 1)
    assert block().xBusy
    with demo.python.DemoPublisher(topic) as publisher:  # sees no heartbeat, and overwrites the name
        clock.add(1)
        assert (block().xSent, block.eErrorID) == (False, "WRITER_IN_USE")
        publisher.publish(demo.message(1))
    assert WATCHED * 1000 == CLAIM


def test_plc_restarts_its_watch_after_another_claim(demo: Demo, clock: Clock, topic: str) -> None:
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


def test_python_gives_up_if_a_plc_overwrites_its_claim(demo: Demo, topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Overwrite the name with the PLC's name while Python waits to confirm its claim."""
    demo.opened(topic)
    memory, sleep = Memory(topic), time.sleep

    def sleep_after_change(seconds: float) -> None:
        if memory["writer"] == os.getpid():
            memory["writer"] = header.PLC
        sleep(seconds)

    monkeypatch.setattr(time, "sleep", sleep_after_change)
    with pytest.raises(RegionInUse, match="a PLC publishes already"):
        demo.python.DemoPublisher(topic)


# --- the semaphore, the lock, the header --------------------------------------------------------------


@pytest.mark.parametrize("opener", ["Python", "PLC"])
def test_semaphore_is_corrected_if_another_acquired_it_early(demo: Demo, clock: Clock, topic: str, opener: str) -> None:
    demo.plc.born(1)
    demo.plc.fail("SysSemProcessEnter", 5)  # another process has acquired the semaphore
    block = demo.publisher(topic)()
    demo.plc.fail("", 0)
    assert (semaphore(topic).value, Memory(topic)["recoveries"]) == (2, 1)
    if opener == "PLC":
        ready(block)
    else:
        with demo.python.DemoPublisher(topic) as publisher:
            publisher.publish(demo.message(1))
    assert semaphore(topic).value == 1


def test_python_does_not_recover_a_lock_that_was_free(demo: Demo, topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the lock to its new holder, which has not increased `lock_count` yet."""
    use_python(monkeypatch)
    monkeypatch.setattr(lock, "_STUCK_AFTER", 0.2)
    with demo.python.DemoPublisher(topic) as publisher:
        mutex, memory = semaphore(topic), Memory(topic)
        mutex.acquire(0)
        memory["lock_count"], memory["lock_holder"] = memory["lock_count"] + 1, os.getppid()
        publisher.publish(demo.message(1))
        assert publisher.lock_misses == 1
        memory["lock_holder"] = 0
        mutex.release()
        time.sleep(0.3)
        mutex.acquire(0)
        publisher.publish(demo.message(2))
        assert (publisher.lock_misses, memory["recoveries"]) == (2, 0)


def test_plc_does_not_recover_a_lock_that_was_free(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.opened(topic)
    mutex, memory = semaphore(topic), Memory(topic)
    mutex.acquire(0)
    memory["lock_count"], memory["lock_holder"] = memory["lock_count"] + 1, os.getppid()
    block()
    memory["lock_holder"] = 0
    clock.add(HEAL)
    block()
    assert memory["recoveries"] == 0


def test_header_overwritten_at_creation_is_refused(demo: Demo, topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    block = demo.publisher(topic)()
    Memory(topic).poke(8, b"\x99")
    block()
    ready(block)
    assert block.eErrorID == "DIGEST_MISMATCH"

    other, sleep = f"{topic}/python", time.sleep

    def sleep_after_change(seconds: float) -> None:
        with suppress(FileNotFoundError, ValueError):
            if region_of(other).words[0]:  # the header is written, and the creator waits for others
                Memory(other).poke(8, b"\x99")
        sleep(seconds)

    monkeypatch.setattr(time, "sleep", sleep_after_change)
    with pytest.raises(LayoutMismatch):
        demo.python.DemoSubscriber(other)
