"""The generated blocks, running, against the Python runtime on real shared memory: every way it goes, and goes wrong.

The PLC's clock stands still but for what a test adds to it, and begins just before it wraps round.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import posix_ipc
import pytest

from shmgen.runtime.errors import RegionInUse
from shmgen.runtime.names import region_name

from .conftest import REPOSITORY
from .softplc import Block
from .support.plc_demo import Demo, Memory, make

RETRY, CLAIM, HEAL = 500, 1000, 1000
"""Milliseconds, as documented."""


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    return make(tmp_path_factory.mktemp("demo"))


class Clock:
    """That of the PLC."""

    def __init__(self, demo: Demo) -> None:
        self._plc, self._now = demo.plc, 2**32 - 700
        self.add(0)

    def add(self, ms: int) -> None:
        self._now = (self._now + ms) % 2**32
        self._plc.set_clock(self._now)


@pytest.fixture
def clock(shared: Demo) -> Clock:
    return Clock(shared)


@pytest.fixture
def demo(shared: Demo, clock: Clock) -> Iterator[Demo]:
    """A PLC as it comes; that no block ever waited for a semaphore is true of every test."""
    shared.plc.born(1)
    shared.plc.round_sizes(False)
    shared.plc.fail("", 0)
    yield shared
    assert shared.plc.waits == 0


@pytest.fixture(params=["exact", "rounded"])
def sizes(request: pytest.FixtureRequest, demo: Demo) -> None:
    demo.plc.round_sizes(request.param == "rounded")


def semaphore(topic: str, suffix: str = "") -> posix_ipc.Semaphore:
    return posix_ipc.Semaphore(f"/{region_name(topic)}{suffix}")


# --- both start orders --------------------------------------------------------------------------------


@pytest.mark.parametrize("born", [0, 1])
@pytest.mark.usefixtures("sizes")
def test_python_first(demo: Demo, topic: str, born: int) -> None:
    demo.plc.born(born)
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        publisher.publish(demo.message(2))
        block = demo.subscriber(topic)()
        assert (block.xNewData, block.xValid, block.xBusy, block.xError) == (True, True, False, False)
        assert (block.Msg.a, block.Msg.b, block.Msg.label, block.Msg.inner.v) == (2, 4, "x2", 1.25)
        assert (block.Msg.tail_count, list(block.Msg.tail)) == (2, [2, -2, 0])
        assert (block.udiSequence, block.udiMissed) == (2, 0)
        assert (block().xNewData, block.xValid, block.Msg.a) == (False, True, 2)
        publisher.publish(demo.message(3))
        publisher.publish(demo.message(4))
        assert (block().Msg.a, block.udiMissed) == (4, 1)
    assert semaphore(topic).value == 1


@pytest.mark.parametrize("born", [0, 1])
@pytest.mark.usefixtures("sizes")
def test_plc_first(demo: Demo, topic: str, born: int) -> None:
    demo.plc.born(born)
    block = demo.publisher(topic)
    block.Msg.a = 7
    assert (block().xSent, block.udiSequence, block.eErrorID) == (True, 1, "NO_ERROR")
    assert (semaphore(topic).value, semaphore(topic, "-event").value) == (1, 0)
    with demo.python.DemoSubscriber(topic) as subscriber:
        message = subscriber.read()
        assert (message.a, message.label, message.inner.k, message.inner.v, list(message.tail)) == (
            7,
            "hey",
            7,
            1.25,
            [],
        )
        assert subscriber.read() is None
        for number in range(5):
            block.Msg.a = number
            block()
        assert (subscriber.read().a, subscriber.missed) == (4, 4)
        block(xSend=False)
        assert (block.xSent, subscriber.read()) == (False, None)


def test_both_sides_write_the_same_header(demo: Demo, topic: str) -> None:
    demo.subscriber(topic)()
    with demo.python.DemoSubscriber(f"{topic}/python"):
        assert Memory(topic).bytes() == Memory(f"{topic}/python").bytes()


def test_a_reader_waits_for_a_writer(demo: Demo, topic: str) -> None:
    block = demo.subscriber(topic)()
    assert (block.xValid, block.xNewData, block.xBusy, block.xError, block.xStale) == (False,) * 5
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(5))
        assert (block().xNewData, block.Msg.a) == (True, 5)


# --- what cannot work ---------------------------------------------------------------------------------

FOREIGN = {
    "NOT_A_REGION": (0, b"OTHER\0\0\0"),
    "ABI_MISMATCH": (4, b"\2\0"),
    "DIGEST_MISMATCH": (8, b"\x99"),
    "PAYLOAD_MISMATCH": (16, b"\x99"),
    "DEPTH_MISMATCH": (28, b"\4"),
}
"""Error -> bytes that make the region foreign, and where."""


@pytest.mark.parametrize("side", ["publisher", "subscriber"])
@pytest.mark.parametrize("error", FOREIGN)
def test_a_foreign_region_is_left_alone(demo: Demo, clock: Clock, topic: str, side: str, error: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        memory = Memory(topic)
        offset, data = FOREIGN[error]
        memory.poke(offset, data)
        before = memory.bytes()
        block = getattr(demo, side)(topic)
        for _ in range(20):
            block()
            clock.add(100)
            assert (block.eErrorID, block.xError, block.xBusy) == (error, True, False)
        assert memory.bytes() == before


@pytest.mark.parametrize(("theirs", "error"), [(3, "DEPTH_MISMATCH"), (200, "REGION_SIZE_MISMATCH")])
@pytest.mark.usefixtures("sizes")
def test_another_depth(demo: Demo, clock: Clock, topic: str, theirs: int, error: str) -> None:
    with demo.python.DemoPublisher(topic, depth=theirs) as publisher:
        publisher.publish(demo.message(1))
        before = Memory(topic).bytes()
        block = demo.subscriber(topic)()
        assert (block.eErrorID, block.xValid) == (error, False)
        assert block._fbRegion.uxSizeFound == len(before)
        assert (block._fbRegion.uxSizeExpected == len(before)) == (error == "DEPTH_MISMATCH")
        assert Memory(topic).bytes() == before
        block(xEnable=False)
        assert (block.xError, block.eErrorID) == (False, "NO_ERROR")
        assert block(xEnable=True, udiDepth=theirs).xNewData


def test_another_message(demo: Demo, topic: str) -> None:
    other = demo.plc.block("FB_demo_msgs_Other_Publisher")(xEnable=True, sTopic=topic)
    assert other.xSent
    before = Memory(topic).bytes()
    assert demo.publisher(topic)().eErrorID == "DIGEST_MISMATCH"
    assert demo.subscriber(topic)().eErrorID == "DIGEST_MISMATCH"
    assert Memory(topic).bytes() == before


def test_what_was_wrong_is_tried_again_every_500_ms(demo: Demo, clock: Clock, topic: str) -> None:
    demo.subscriber(topic)()
    memory = Memory(topic)
    memory["magic"] = 5
    block = demo.publisher(topic)()
    memory["magic"] = 0x474D4853
    clock.add(RETRY - 1)
    assert block().eErrorID == "NOT_A_REGION"
    clock.add(1)
    assert (block().eErrorID, block.xError, block.xSent) == ("NO_ERROR", False, True)


TOPICS = {
    "": "TOPIC_EMPTY", "/": "TOPIC_EMPTY", "//": "TOPIC_INVALID", "/a//b": "TOPIC_INVALID", "/a/": "TOPIC_INVALID",
    "/1a": "TOPIC_INVALID", "/a/1b": "TOPIC_INVALID", "/a.b": "TOPIC_INVALID", "/a-b": "TOPIC_INVALID",
    "/a b": "TOPIC_INVALID", "/sem/x": "TOPIC_INVALID", "/caf\N{LATIN SMALL LETTER E WITH ACUTE}": "TOPIC_INVALID",
    "/" + "x" * 75: "TOPIC_TOO_LONG",
}  # fmt: skip


@pytest.mark.parametrize("wrong", TOPICS)
def test_a_topic_that_cannot_be(demo: Demo, clock: Clock, wrong: str) -> None:
    block = demo.subscriber(wrong)()
    assert (block.eErrorID, block.xError) == (TOPICS[wrong], True)
    clock.add(10_000)
    assert block().eErrorID == TOPICS[wrong]


def test_topics_become_the_names_that_python_gives_them(demo: Demo, topic: str) -> None:
    for name in (f"{topic}/Z_9", f"{topic[1:]}/b", f"{topic}/{'x' * (74 - len(topic))}"):
        assert demo.publisher(name)().eErrorID == "NO_ERROR"
        with demo.python.DemoSubscriber(name) as subscriber:
            assert subscriber.read() is not None


@pytest.mark.parametrize("depth", [0, 65536])
def test_a_depth_that_cannot_be(demo: Demo, topic: str, depth: int) -> None:
    assert demo.subscriber(topic, udiDepth=depth)().eErrorID == "DEPTH_INVALID"


def test_a_compiler_that_lays_out_otherwise(demo: Demo, topic: str) -> None:
    region = demo.plc.block("FB_ShmRegion")
    sizes = {"udiPayloadSize": 64, "udiSizeOf": 60}
    assert region.method("Init", sTopic=topic, sTypeName="a/msg/B", lwDigest=1, udiDepth=1, **sizes) is False
    assert region.eErrorID == "SIZEOF_MISMATCH"
    assert region.method("Cycle") is False
    with pytest.raises(FileNotFoundError):
        Memory(topic)


FAILURES = {
    "REGION_NO_ACCESS": ("SysSharedMemoryOpen2", 25),
    "REGION_NO_MEMORY": ("SysSharedMemoryCreate", 17),
    "REGION_OPEN_FAILED": ("SysSharedMemoryOpen2", 1),
    "REGION_NO_POINTER": ("SysSharedMemoryGetPointer", 1),
    "SEMAPHORE_NO_ACCESS": ("SysSemProcessCreate", 25),
    "SEMAPHORE_FAILED": ("SysSemProcessCreate", 17),
}


@pytest.mark.parametrize("error", FAILURES)
def test_what_the_system_refuses(demo: Demo, clock: Clock, topic: str, error: str) -> None:
    demo.plc.fail(*FAILURES[error])
    block = demo.publisher(topic)()
    assert (block.eErrorID, block.xSent) == (error, False)
    demo.plc.fail("", 0)
    clock.add(RETRY)
    assert (block().eErrorID, block.xSent) == ("NO_ERROR", True)


def test_a_lock_that_is_broken(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.publisher(topic)()
    demo.plc.fail("SysSemProcessEnter", 1)
    for _ in range(10):
        assert (block().eErrorID, block.xSent) == ("NO_ERROR", False)
        clock.add(HEAL // 10)
    assert block().eErrorID == "LOCK_FAILED"
    demo.plc.fail("", 0)
    clock.add(max(RETRY, CLAIM))
    assert (block().eErrorID, block.xSent) == ("NO_ERROR", True)


def test_every_error_has_been_seen(demo: Demo) -> None:
    here = Path(__file__).read_text()
    names = set(demo.plc.offsets["E_SHMERROR"])
    assert names == {name for name in names if f'"{name}"' in here}


# --- one writer ---------------------------------------------------------------------------------------


def test_a_second_plc_gives_way_to_the_first(demo: Demo, clock: Clock, topic: str) -> None:
    first, second = demo.publisher(topic)(), demo.publisher(topic)()
    assert (second.xBusy, second.xError, second.xSent) == (True, False, False)
    first()
    assert (second().eErrorID, second.xSent, first().xSent) == ("WRITER_IN_USE", False, True)


def test_a_writer_whose_heartbeat_stands_is_gone(demo: Demo, clock: Clock, topic: str) -> None:
    first, second = demo.publisher(topic)(), demo.publisher(topic)()
    clock.add(CLAIM - 1)
    assert second().xBusy
    clock.add(1)
    assert (second().xSent, second.udiSequence) == (True, 2)
    assert first().eErrorID == "WRITER_IN_USE"  # it comes back, and sees that somebody else has taken over
    assert second().xSent


def test_the_plc_gives_way_to_python(demo: Demo, topic: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        block = demo.publisher(topic)()
        assert (block.xBusy, block.xSent) == (True, False)
        publisher.publish(demo.message(1))
        assert (block().eErrorID, Memory(topic)["writer"]) == ("WRITER_IN_USE", os.getpid())


def test_python_takes_over_a_plc_that_stands_still(demo: Demo, topic: str) -> None:
    block = demo.publisher(topic)()
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        assert (block().eErrorID, block.xSent, Memory(topic)["writer"]) == ("WRITER_IN_USE", False, os.getpid())


def test_python_gives_way_to_a_plc_that_runs(demo: Demo, topic: str) -> None:
    block = demo.publisher(topic)()
    runs = threading.Thread(target=block.run, args=(0.001, 600))
    runs.start()
    try:
        with pytest.raises(RegionInUse, match="PLC"):
            demo.python.DemoPublisher(topic)
    finally:
        runs.join()


def test_an_orderly_end_frees_the_topic(demo: Demo, topic: str) -> None:
    block = demo.publisher(topic)()
    block(xEnable=False)
    assert (Memory(topic)["writer"], block.xError, block.xBusy) == (0, False, False)
    assert demo.publisher(topic)().xSent


# --- the lock -----------------------------------------------------------------------------------------


@contextmanager
def held(topic: str) -> Iterator[posix_ipc.Semaphore]:
    lock = semaphore(topic)
    lock.acquire(0)
    yield lock
    lock.release()


def test_a_lock_that_is_not_free_is_only_tried(demo: Demo, topic: str) -> None:
    with demo.python.DemoPublisher(topic, lock_timeout=0) as publisher:
        publisher.publish(demo.message(1))
        block = demo.subscriber(topic)()
        with held(topic):
            publisher.publish(demo.message(2))
            for misses in range(1, 4):
                block()
                assert (block.xNewData, block.xValid, block.xError, block.Msg.a) == (False, True, False, 1)
                assert block.udiLockMisses == misses
        assert (block().Msg.a, block.udiMissed) == (2, 0)


def test_a_writer_skips_the_cycle(demo: Demo, topic: str) -> None:
    block = demo.publisher(topic)()
    with held(topic):
        before = Memory(topic)["begun"], Memory(topic)["completed"]
        assert (block().xSent, block.xError, block.udiLockMisses, block.udiSequence) == (False, False, 1, 1)
        assert (Memory(topic)["begun"], Memory(topic)["completed"]) == before
    assert (block().xSent, block.udiSequence) == (True, 2)


def test_a_stuck_lock_is_freed_after_a_second(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.publisher(topic)()
    lock, memory = semaphore(topic), Memory(topic)
    lock.acquire(0)
    memory["lock_holder"] = 12345
    block()
    clock.add(HEAL - 1)
    block()
    assert (lock.value, memory["recoveries"]) == (0, 0)
    clock.add(1)
    block()
    assert (lock.value, memory["recoveries"], memory["lock_holder"]) == (1, 1, 0)
    assert block().xSent
    lock.release()  # the holder comes back: 2, which is taken down
    assert (block().xSent, lock.value) == (True, 1)


def test_a_lock_that_others_pass_is_not_stuck(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.publisher(topic)()
    memory = Memory(topic)
    with held(topic) as lock:
        for _ in range(10):
            assert not block().xSent
            memory["lock_count"] += 1
            clock.add(HEAL - 1)
        assert (lock.value, memory["recoveries"]) == (0, 0)


# --- samples ------------------------------------------------------------------------------------------


def test_each_unread_sample_in_order(demo: Demo, topic: str) -> None:
    block = demo.subscriber(topic, xNewest=False, udiDepth=4)
    with demo.python.DemoPublisher(topic, depth=4) as publisher:
        publisher.publish(demo.message(1))
        publisher.publish(demo.message(2))
        assert drained(block) == [2]  # what lay there before the first look does not count, but for the newest
        for number in range(3, 7):
            publisher.publish(demo.message(number))
        assert (drained(block), block.udiMissed) == ([3, 4, 5, 6], 0)
        for number in range(7, 30):
            publisher.publish(demo.message(number))
        assert (drained(block), block.udiMissed) == (list(range(22, 30)), 15)


def drained(block: Block) -> list[int]:
    found = []
    while block().xNewData:
        assert block.Msg.b == 2 * block.Msg.a
        found.append(block.Msg.a)
    return found


def test_numbers_wrap_round(demo: Demo, topic: str) -> None:
    block = demo.subscriber(topic)()
    memory = Memory(topic)
    memory["begun"] = memory["completed"] = 0xFFFFFFFD
    writer = demo.publisher(topic)
    assert [writer().udiSequence for _ in range(4)] == [0xFFFFFFFE, 0xFFFFFFFF, 2, 3]
    block(xEnable=False)
    assert block(xEnable=True).udiSequence == 3
    assert (writer().udiSequence, block().udiSequence, block.udiMissed) == (4, 4, 0)
    with demo.python.DemoSubscriber(topic) as subscriber:
        assert (subscriber.read().a, subscriber.sequence) == (0, 4)


def test_the_wrap_loses_what_lies_before_it_and_says_so(demo: Demo, topic: str) -> None:
    """By the rule of the protocol: (begun - number) modulo 2**32 is no longer below the number of slots."""
    with demo.python.DemoPublisher(topic, depth=4):
        memory = Memory(topic)
        memory["begun"] = memory["completed"] = 0xFFFFFFFC
    with (
        demo.python.DemoPublisher(topic, depth=4) as publisher,
        demo.python.DemoSubscriber(topic, depth=4) as subscriber,
    ):
        publisher.publish(demo.message(1))
        block = demo.subscriber(topic, xNewest=False, udiDepth=4)
        assert drained(block) == [sample.a for sample in subscriber.read_all()] == [1]
        for number in range(2, 6):
            publisher.publish(demo.message(number))
        assert (drained(block), block.udiMissed, block.udiSequence) == ([5], 3, 9)


def test_a_sample_overwritten_while_it_is_read_is_thrown_away(demo: Demo, topic: str) -> None:
    region = demo.plc.block("FB_ShmRegion")
    with demo.python.DemoPublisher(topic) as publisher:
        size = demo.plc.sizes["ST_DEMO_MSGS_DEMO"]
        digest = demo.python.Demo._digest_
        settings = {"lwDigest": digest, "udiPayloadSize": size, "udiSizeOf": size, "udiDepth": 1}
        assert region.method("Init", sTopic=topic, sTypeName="demo_msgs/msg/Demo", **settings)
        assert region.method("Cycle")
        publisher.publish(demo.message(1))
        assert region.method("BeginRead", xNewest=True) != 0
        Memory(topic)["begun"] += 2  # as a writer does that goes on without the lock
        assert region.method("EndRead") is False
        assert (region.udiSequence, semaphore(topic).value) == (0, 1)


def test_stale(demo: Demo, clock: Clock, topic: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        block = demo.subscriber(topic, tTimeout=200)()
        assert (block.xValid, block.xStale) == (True, False)
        clock.add(199)
        assert not block().xStale
        clock.add(1)
        assert (block().xStale, block.xValid, block.xError) == (True, True, False)
        publisher.heartbeat()
        assert not block().xStale
        clock.add(1000)
        block(xEnable=False)
        assert (block.xStale, block.xValid, block.xError, block.xBusy) == (False,) * 4


def test_a_waiting_reader_is_woken(demo: Demo, topic: str) -> None:
    block = demo.publisher(topic)()
    memory, event = Memory(topic), semaphore(topic, "-event")
    block()
    assert event.value == 0
    memory["armed"] = 1
    block()
    assert (memory["armed"], event.value) == (0, 1)
    block()
    assert event.value == 1


def test_a_topic_beneath_named_event_is_another_semaphore(demo: Demo, topic: str) -> None:
    outer, inner = demo.publisher(topic)(), demo.publisher(f"{topic}/event")()
    assert (outer().xSent, inner().xSent, semaphore(f"{topic}/event").value) == (True, True, 1)


def test_exit_closes_unless_it_is_an_online_change(demo: Demo, topic: str) -> None:
    block = demo.publisher(topic)()
    region = block._fbRegion  # the runtime calls FB_Exit of each instance, also of one inside another
    region.method("FB_Exit", bInCopyCode=True)
    assert (block().xSent, block.udiSequence, Memory(topic)["writer"]) == (True, 2, 0xFFFFFFFF)
    region.method("FB_Exit", bInCopyCode=False)
    assert Memory(topic)["writer"] == 0
    assert not block().xSent


# --- sudden death -------------------------------------------------------------------------------------

WRITER = """
import itertools, sys
sys.path.insert(0, sys.argv[1])
from shm_plc_demo.demo_msgs.msg import Demo, DemoPublisher
with DemoPublisher(sys.argv[2]) as publisher:
    for number in itertools.count(1):
        publisher.publish(Demo(a=number, b=2 * number & 0xFFFFFFFF))
        if number == 1000:
            print("running", flush=True)
"""


@contextmanager
def running(*command: str) -> Iterator[subprocess.Popen[str]]:
    """A process that has said `running`; killed at the end."""
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True, cwd=REPOSITORY) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "running\n"
            yield process
        finally:
            process.send_signal(signal.SIGKILL)


@pytest.mark.parametrize("attempt", range(3))
def test_the_last_sample_of_a_dead_python(demo: Demo, topic: str, attempt: int) -> None:
    with running("-c", WRITER, str(demo.library.parents[1] / "python"), topic):
        time.sleep(0.01 * attempt)
    memory = Memory(topic)
    if semaphore(topic).value == 0:  # it died inside
        semaphore(topic).release()
    block = demo.subscriber(topic)()
    assert (block.xNewData, block.udiSequence) == (True, memory["completed"])
    assert block.Msg.a == memory["completed"] > 0
    assert block.Msg.b == 2 * block.Msg.a & 0xFFFFFFFF


def test_the_last_sample_of_a_dead_plc(demo: Demo, clock: Clock, topic: str) -> None:
    task = ["-m", "tests.softplc.task", str(demo.library), "FB_demo_msgs_Demo_Publisher", "--period", "0"]
    with running(*task, "--set", "xEnable=true", f'sTopic="{topic}"'), pytest.raises(RegionInUse):
        demo.python.DemoPublisher(topic)
    memory = Memory(topic)
    if semaphore(topic).value == 0:
        semaphore(topic).release()
    with demo.python.DemoSubscriber(topic) as subscriber:
        assert (subscriber.read().label, subscriber.sequence) == ("hey", memory["completed"])
    block = demo.subscriber(topic)()
    assert (block.Msg.label, block.udiSequence) == ("hey", memory["completed"])
    writer = demo.publisher(topic)()
    clock.add(CLAIM)
    assert (writer().xSent, writer.udiSequence) == (True, memory["completed"])


def test_a_write_that_was_never_completed_is_not_seen(demo: Demo, topic: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        memory = Memory(topic)
        slot = 192 + 128 * 0  # sample 2 goes into slot 0
        memory["begun"] = 2
        memory.poke(slot, b"\xff" * 40)
        block = demo.subscriber(topic)()
        assert (block.xNewData, block.Msg.a, block.Msg.b, block.udiSequence) == (True, 1, 2, 1)


def test_a_fast_writer_never_tears_a_sample(demo: Demo, topic: str) -> None:
    last, new = 0, 0
    with running("-c", WRITER, str(demo.library.parents[1] / "python"), topic):
        block = demo.subscriber(topic)
        for _ in range(20_000):
            if block().xNewData:
                assert (block.Msg.b, block.Msg.a > last) == (2 * block.Msg.a, True)
                last, new = block.Msg.a, new + 1
    assert new > 10


# --- what is planted must be found --------------------------------------------------------------------


def test_no_call_can_wait(demo: Demo) -> None:
    """Beside what each test here counts: the text itself knows no other time limit."""
    for path, text in demo.texts.items():
        if path.endswith(".st"):
            assert {limit for limit in re.findall(r"SysSemProcessEnter\(\w+, ([^)]+)\)", text)} <= {"0"}, path
