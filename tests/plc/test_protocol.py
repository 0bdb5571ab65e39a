"""The generated blocks, running, against the Python runtime: who is there first, what cannot work, who may write.

The PLC's clock stands still but for what a test adds to it, and begins just before it wraps round.
"""

from __future__ import annotations

import os
import re
import threading
from pathlib import Path

import pytest

from shmgen.live.classes import watcher
from shmgen.live.regions import View
from shmgen.runtime import read_header, region_name
from shmgen.runtime.errors import RegionInUse
from shmgen.runtime.region.header import header_for
from shmgen.runtime.region.names import region_file

from ..support.plc_demo import CLAIM, CONFIRM, HEAL, RETRY, Clock, Demo, Memory, semaphore

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
def test_plc_first(demo: Demo, clock: Clock, topic: str, born: int) -> None:
    demo.plc.born(born)
    block = demo.publisher(topic)
    block.Msg.a = 7
    assert (block().xBusy, block().xSent) == (True, False)  # its name stands there, and may be written over
    clock.add(CONFIRM)
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


def test_a_sample_has_the_time_that_the_plc_was_given(demo: Demo, topic: str) -> None:
    """As delay and the recorder see it; 0 is none."""
    block, clock = demo.opened(topic), demo.plc.globals("GVL_ShmClock")
    with View(region_name(topic)) as view, watcher(view) as seen:
        for now in (0, 1_700_000_000_123_456_789, 0):
            clock.lwNow = now
            number = block().udiSequence
            assert [(one.number, one.stamp) for one in seen.samples()][-1] == (number, now)
            assert view.stamp(number, view.header()) == now


def test_both_sides_write_the_same_header(demo: Demo, topic: str) -> None:
    demo.subscriber(topic)()
    with demo.python.DemoSubscriber(f"{topic}/python"):
        Memory(topic)["ordered"] = Memory(f"{topic}/python")["ordered"]  # a PLC does not know on what it runs
        assert Memory(topic).bytes() == Memory(f"{topic}/python").bytes()


@pytest.mark.parametrize("letters", [1, 63, 64, 80, 95])
def test_a_type_name_of_any_length_is_whole(demo: Demo, topic: str, letters: int) -> None:
    name = ("kartech_linear_actuator_msgs/msg/" + 95 * "N")[:letters]
    region = demo.plc.block("FB_ShmRegion")
    assert region.method("Init", sTopic=topic, sTypeName=name, lwDigest=1, udiPayloadSize=8, udiSizeOf=8, udiDepth=1)
    assert not region.method("Cycle")  # who has written the header looks at it again
    assert region.method("Cycle")
    assert read_header(region_name(topic)) == header_for(name, 1, 8, 1)


def test_a_reader_waits_for_a_writer(demo: Demo, topic: str) -> None:
    block = demo.subscriber(topic)()
    assert (block.xBusy, block.xError) == (True, False)
    block()
    assert (block.xValid, block.xNewData, block.xBusy, block.xError, block.xStale) == (False,) * 5
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(5))
        assert (block().xNewData, block.Msg.a) == (True, 5)


# --- what cannot work ---------------------------------------------------------------------------------

FOREIGN = {
    "NOT_A_REGION": (0, b"OTHER\0\0\0"),
    "ABI_MISMATCH": (4, b"\1\0"),
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
    demo.plc.block("FB_demo_msgs_Other_Publisher")(xEnable=True, sTopic=topic)
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
    block()
    assert (block().eErrorID, block.xError, block.xSent) == ("NOT_A_REGION", True, False)  # until it is ready
    clock.add(CONFIRM)
    assert (block().eErrorID, block.xError, block.xSent) == ("NO_ERROR", False, True)


TOPICS = {
    "": "TOPIC_EMPTY", "/": "TOPIC_EMPTY", "//": "TOPIC_INVALID", "/a//b": "TOPIC_INVALID", "/a/": "TOPIC_INVALID",
    "/1a": "TOPIC_INVALID", "/a/1b": "TOPIC_INVALID", "/a.b": "TOPIC_INVALID", "/a-b": "TOPIC_INVALID",
    "/a b": "TOPIC_INVALID", "/sem/x": "TOPIC_INVALID", "/caf\N{LATIN SMALL LETTER E WITH ACUTE}": "TOPIC_INVALID",
    "/" + "x" * 75: "TOPIC_TOO_LONG", "/CME": "TOPIC_INVALID", "GWDrvSharedMemShm": "TOPIC_INVALID",
    "RetainMemory": "TOPIC_INVALID",
}  # fmt: skip


@pytest.mark.parametrize("wrong", TOPICS)
def test_a_topic_that_cannot_be(demo: Demo, clock: Clock, wrong: str) -> None:
    block = demo.subscriber(wrong)()
    assert (block.eErrorID, block.xError) == (TOPICS[wrong], True)
    clock.add(10_000)
    assert block().eErrorID == TOPICS[wrong]


def test_topics_become_the_names_that_python_gives_them(demo: Demo, topic: str) -> None:
    for name in (f"{topic}/Z_9", f"{topic[1:]}/b", f"{topic}/{'x' * (74 - len(topic))}"):
        assert demo.opened(name).eErrorID == "NO_ERROR"
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
    block()
    block()
    clock.add(CONFIRM)
    assert (block().eErrorID, block.xSent) == ("NO_ERROR", True)


def test_a_lock_that_is_broken(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.opened(topic)
    demo.plc.fail("SysSemProcessEnter", 1)
    for _ in range(10):
        assert (block().eErrorID, block.xSent) == ("NO_ERROR", False)
        clock.add(HEAL // 10)
    assert block().eErrorID == "LOCK_FAILED"
    demo.plc.fail("", 0)
    clock.add(RETRY)
    assert (block().eErrorID, block.xSent) == ("LOCK_FAILED", False)
    clock.add(CLAIM)
    block()
    clock.add(CONFIRM)
    assert (block().eErrorID, block.xSent) == ("NO_ERROR", True)


@pytest.mark.parametrize("side", ["publisher", "subscriber"])
def test_a_region_that_is_retired_is_opened_anew(demo: Demo, clock: Clock, topic: str, side: str) -> None:
    """The PLC lets go at once, and waits where the name is still to be taken away."""
    block = getattr(demo, side)(topic)()
    clock.add(CONFIRM)
    assert block().eErrorID == "NO_ERROR"
    Memory(topic)["retired"] = 1
    assert (block().eErrorID, block.xBusy) == ("REGION_RETIRED", False)
    clock.add(RETRY)
    assert block().eErrorID == "REGION_RETIRED"
    Path(region_file(region_name(topic))).unlink()
    clock.add(RETRY)
    block()
    block()
    clock.add(CONFIRM)
    assert block().eErrorID == "NO_ERROR"
    if side == "publisher":
        assert block().xSent
        with demo.python.DemoSubscriber(topic) as subscriber:
            assert subscriber.read() is not None
    else:
        with demo.python.DemoPublisher(topic) as publisher:
            publisher.publish(demo.message(7))
            assert (block().xNewData, block.Msg.a) == (True, 7)


def test_every_error_has_been_seen(demo: Demo) -> None:
    here = "".join(
        Path(__file__).with_name(f"test_{name}.py").read_text() for name in ("protocol", "services", "counts")
    )
    names = set(demo.plc.offsets["E_SHMERROR"])
    assert names == {name for name in names if f'"{name}"' in here}


# --- one writer ---------------------------------------------------------------------------------------


def test_a_second_plc_gives_way_to_the_first(demo: Demo, clock: Clock, topic: str) -> None:
    first, second = demo.opened(topic), demo.publisher(topic)()
    assert (second.xBusy, second.xError, second.xSent) == (True, False, False)
    first()
    assert (second().eErrorID, second.xSent, first().xSent) == ("WRITER_IN_USE", False, True)


def test_a_writer_whose_heartbeat_stands_is_gone(demo: Demo, clock: Clock, topic: str) -> None:
    first, second = demo.opened(topic), demo.publisher(topic)()
    clock.add(CLAIM - 1)
    assert second().xBusy
    clock.add(1)
    assert second().xBusy
    clock.add(CONFIRM)
    assert (second().xSent, second.udiSequence) == (True, 3)  # 2 is that which the first may still use
    assert first().eErrorID == "WRITER_IN_USE"  # it comes back, and sees that somebody else has taken over
    assert (second().xSent, second.udiSequence) == (True, 4)


def test_a_lock_left_by_the_writer_before_is_freed_while_the_topic_is_watched(
    demo: Demo, clock: Clock, topic: str
) -> None:
    demo.opened(topic)
    lock, memory = semaphore(topic), Memory(topic)
    lock.acquire(0)
    block = demo.publisher(topic)()
    assert block.xBusy
    clock.add(CLAIM - 1)
    block()
    clock.add(1)
    block()
    clock.add(CONFIRM)
    assert (block().xSent, memory["recoveries"], lock.value) == (False, 1, 1)
    assert (block().xSent, block.udiLockMisses) == (True, 1)


def test_a_writer_on_standby_takes_over_a_second_after_the_last_sign_of_life(
    demo: Demo, clock: Clock, topic: str
) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        block = demo.publisher(topic)()
        for _ in range(5):
            publisher.publish(demo.message(1))
            assert (block().eErrorID, block.xBusy, block.xSent) == ("WRITER_IN_USE", False, False)
            clock.add(CLAIM - 1)
        assert (block().xSent, Memory(topic)["writer"]) == (False, os.getpid())
    clock.add(1)
    assert not block().xSent
    clock.add(CONFIRM)
    assert (block().xSent, block.eErrorID, block.udiLockMisses) == (True, "NO_ERROR", 0)
    assert Memory(topic)["lock_count"] > 5 + 1  # it has tried the lock, and given it back
    assert semaphore(topic).value == 1


def test_the_plc_gives_way_to_python(demo: Demo, topic: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        block = demo.publisher(topic)()
        assert (block.xBusy, block.xSent) == (True, False)
        publisher.publish(demo.message(1))
        assert (block().eErrorID, Memory(topic)["writer"]) == ("WRITER_IN_USE", os.getpid())


def test_python_takes_over_a_plc_that_stands_still(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        assert (block().eErrorID, block.xSent, Memory(topic)["writer"]) == ("WRITER_IN_USE", False, os.getpid())


def test_python_gives_way_to_a_plc_that_runs(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    runs = threading.Thread(target=block.run, args=(0.001, 600))
    runs.start()
    try:
        with pytest.raises(RegionInUse, match="PLC"):
            demo.python.DemoPublisher(topic)
    finally:
        runs.join()


def test_an_orderly_end_frees_the_topic(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    block(xEnable=False)
    assert (Memory(topic)["writer"], block.xError, block.xBusy) == (0, False, False)
    assert demo.opened(topic).xSent


def test_no_call_can_wait(demo: Demo) -> None:
    """Beside what each test here counts: the text itself knows no other time limit."""
    for path, text in demo.texts.items():
        if path.endswith(".st"):
            assert set(re.findall(r"SysSemProcessEnter\(\w+, ([^)]+)\)", text)) <= {"0"}, path
