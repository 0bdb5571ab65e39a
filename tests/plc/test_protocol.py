"""Generated blocks follow the same protocol as the Python runtime: start order, errors, and one writer per topic.

The PLC's clock changes only when a test advances it, and starts shortly before it wraps around.
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


@pytest.mark.parametrize("initial_value", [0, 1])
@pytest.mark.usefixtures("sizes")
def test_plc_opens_the_region_of_python(demo: Demo, topic: str, initial_value: int) -> None:
    demo.plc.born(initial_value)
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


@pytest.mark.parametrize("initial_value", [0, 1])
@pytest.mark.usefixtures("sizes")
def test_python_opens_the_region_of_a_plc(demo: Demo, clock: Clock, topic: str, initial_value: int) -> None:
    demo.plc.born(initial_value)
    block = demo.publisher(topic)
    block.Msg.a = 7
    assert (block().xBusy, block().xSent) == (True, False)  # the name is written, but not confirmed yet
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


def test_sample_has_the_time_of_the_plc_clock(demo: Demo, topic: str) -> None:
    """Read the time as `shmgen delay` and the recorder do. The value 0 means that there is no time."""
    block, clock = demo.opened(topic), demo.plc.globals("GVL_ShmClock")
    with View(region_name(topic)) as view, watcher(view) as observer:
        for now in (0, 1_700_000_000_123_456_789, 0):
            clock.lwNow = now
            number = block().udiSequence
            assert [(one.number, one.stamp) for one in observer.samples()][-1] == (number, now)
            assert view.stamp(number, view.header()) == now


def test_both_sides_write_the_same_header(demo: Demo, topic: str) -> None:
    demo.subscriber(topic)()
    with demo.python.DemoSubscriber(f"{topic}/python"):
        Memory(topic)["ordered"] = Memory(f"{topic}/python")["ordered"]  # a PLC does not know its processor
        assert Memory(topic).bytes() == Memory(f"{topic}/python").bytes()


@pytest.mark.parametrize("letters", [1, 63, 64, 80, 95])
def test_type_name_of_any_length_is_complete(demo: Demo, topic: str, letters: int) -> None:
    name = ("kartech_linear_actuator_msgs/msg/" + 95 * "N")[:letters]
    region = demo.plc.block("FB_ShmRegion")
    assert region.method("Init", sTopic=topic, sTypeName=name, lwDigest=1, udiPayloadSize=8, udiSizeOf=8, udiDepth=1)
    assert not region.method("Cycle")  # the block checks the header one call after writing it
    assert region.method("Cycle")
    assert read_header(region_name(topic)) == header_for(name, 1, 8, 1)


def test_subscriber_waits_for_a_publisher(demo: Demo, topic: str) -> None:
    block = demo.subscriber(topic)()
    assert (block.xBusy, block.xError) == (True, False)
    block()
    assert (block.xValid, block.xNewData, block.xBusy, block.xError, block.xStale) == (False,) * 5
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(5))
        assert (block().xNewData, block.Msg.a) == (True, 5)


# --- errors -------------------------------------------------------------------------------------------

INCOMPATIBLE = {
    "NOT_A_REGION": (0, b"OTHER\0\0\0"),
    "ABI_MISMATCH": (4, b"\1\0"),
    "DIGEST_MISMATCH": (8, b"\x99"),
    "PAYLOAD_MISMATCH": (16, b"\x99"),
    "DEPTH_MISMATCH": (28, b"\4"),
}
"""The offset and the bytes that make a region incompatible, for each error."""


@pytest.mark.parametrize("side", ["publisher", "subscriber"])
@pytest.mark.parametrize("error", INCOMPATIBLE)
def test_incompatible_region_is_not_changed(demo: Demo, clock: Clock, topic: str, side: str, error: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        memory = Memory(topic)
        offset, data = INCOMPATIBLE[error]
        memory.poke(offset, data)
        before = memory.bytes()
        block = getattr(demo, side)(topic)
        for _ in range(20):
            block()
            clock.add(100)
            assert (block.eErrorID, block.xError, block.xBusy) == (error, True, False)
        assert memory.bytes() == before


@pytest.mark.parametrize(("depth", "error"), [(3, "DEPTH_MISMATCH"), (200, "REGION_SIZE_MISMATCH")])
@pytest.mark.usefixtures("sizes")
def test_region_with_another_depth_is_refused(demo: Demo, clock: Clock, topic: str, depth: int, error: str) -> None:
    with demo.python.DemoPublisher(topic, depth=depth) as publisher:
        publisher.publish(demo.message(1))
        before = Memory(topic).bytes()
        block = demo.subscriber(topic)()
        assert (block.eErrorID, block.xValid) == (error, False)
        assert block._fbRegion.uxSizeFound == len(before)
        assert (block._fbRegion.uxSizeExpected == len(before)) == (error == "DEPTH_MISMATCH")
        assert Memory(topic).bytes() == before
        block(xEnable=False)
        assert (block.xError, block.eErrorID) == (False, "NO_ERROR")
        assert block(xEnable=True, udiDepth=depth).xNewData


def test_region_of_another_message_is_refused(demo: Demo, topic: str) -> None:
    demo.plc.block("FB_demo_msgs_Other_Publisher")(xEnable=True, sTopic=topic)
    before = Memory(topic).bytes()
    assert demo.publisher(topic)().eErrorID == "DIGEST_MISMATCH"
    assert demo.subscriber(topic)().eErrorID == "DIGEST_MISMATCH"
    assert Memory(topic).bytes() == before


def test_opening_is_retried_every_500_ms(demo: Demo, clock: Clock, topic: str) -> None:
    demo.subscriber(topic)()
    memory = Memory(topic)
    memory["magic"] = 5
    block = demo.publisher(topic)()
    memory["magic"] = 0x474D4853
    clock.add(RETRY - 1)
    assert block().eErrorID == "NOT_A_REGION"
    clock.add(1)
    block()
    assert (block().eErrorID, block.xError, block.xSent) == (
        "NOT_A_REGION",
        True,
        False,
    )  # until the claim succeeds
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
def test_invalid_topic_is_refused(demo: Demo, clock: Clock, wrong: str) -> None:
    block = demo.subscriber(wrong)()
    assert (block.eErrorID, block.xError) == (TOPICS[wrong], True)
    clock.add(10_000)
    assert block().eErrorID == TOPICS[wrong]


def test_plc_and_python_use_the_same_region_names(demo: Demo, topic: str) -> None:
    for name in (f"{topic}/Z_9", f"{topic[1:]}/b", f"{topic}/{'x' * (74 - len(topic))}"):
        assert demo.opened(name).eErrorID == "NO_ERROR"
        with demo.python.DemoSubscriber(name) as subscriber:
            assert subscriber.read() is not None


@pytest.mark.parametrize("depth", [0, 65536])
def test_invalid_depth_is_refused(demo: Demo, topic: str, depth: int) -> None:
    assert demo.subscriber(topic, udiDepth=depth)().eErrorID == "DEPTH_INVALID"


def test_structure_of_another_size_is_refused(demo: Demo, topic: str) -> None:
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
def test_failed_system_function_is_reported_and_retried(demo: Demo, clock: Clock, topic: str, error: str) -> None:
    demo.plc.fail(*FAILURES[error])
    block = demo.publisher(topic)()
    assert (block.eErrorID, block.xSent) == (error, False)
    demo.plc.fail("", 0)
    clock.add(RETRY)
    block()
    block()
    clock.add(CONFIRM)
    assert (block().eErrorID, block.xSent) == ("NO_ERROR", True)


def test_failing_lock_is_reported_and_reopened(demo: Demo, clock: Clock, topic: str) -> None:
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
def test_block_reopens_a_retired_region(demo: Demo, clock: Clock, topic: str, side: str) -> None:
    """Close the retired region at once, and wait until its file is removed."""
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


def test_every_error_has_a_test(demo: Demo) -> None:
    here = "".join(
        Path(__file__).with_name(f"test_{name}.py").read_text() for name in ("protocol", "services", "counts")
    )
    names = set(demo.plc.offsets["E_SHMERROR"])
    assert names == {name for name in names if f'"{name}"' in here}


# --- one writer ---------------------------------------------------------------------------------------


def test_second_plc_publisher_is_refused(demo: Demo, clock: Clock, topic: str) -> None:
    first, second = demo.opened(topic), demo.publisher(topic)()
    assert (second.xBusy, second.xError, second.xSent) == (True, False, False)
    first()
    assert (second().eErrorID, second.xSent, first().xSent) == ("WRITER_IN_USE", False, True)


def test_writer_without_a_heartbeat_is_replaced(demo: Demo, clock: Clock, topic: str) -> None:
    first, second = demo.opened(topic), demo.publisher(topic)()
    clock.add(CLAIM - 1)
    assert second().xBusy
    clock.add(1)
    assert second().xBusy
    clock.add(CONFIRM)
    assert (second().xSent, second.udiSequence) == (True, 3)  # the first writer may still use 2
    assert first().eErrorID == "WRITER_IN_USE"  # the first writer detects that another has taken over
    assert (second().xSent, second.udiSequence) == (True, 4)


def test_lock_of_a_dead_writer_is_recovered_before_a_claim(demo: Demo, clock: Clock, topic: str) -> None:
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


def test_standby_writer_takes_over_after_a_second(demo: Demo, clock: Clock, topic: str) -> None:
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
    assert Memory(topic)["lock_count"] > 5 + 1  # the block has acquired and released the lock
    assert semaphore(topic).value == 1


def test_plc_publisher_is_refused_while_python_publishes(demo: Demo, topic: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        block = demo.publisher(topic)()
        assert (block.xBusy, block.xSent) == (True, False)
        publisher.publish(demo.message(1))
        assert (block().eErrorID, Memory(topic)["writer"]) == ("WRITER_IN_USE", os.getpid())


def test_python_takes_over_from_a_stopped_plc(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        assert (block().eErrorID, block.xSent, Memory(topic)["writer"]) == ("WRITER_IN_USE", False, os.getpid())


def test_python_publisher_is_refused_while_a_plc_runs(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    thread = threading.Thread(target=block.run, args=(0.001, 600))
    thread.start()
    try:
        with pytest.raises(RegionInUse, match="PLC"):
            demo.python.DemoPublisher(topic)
    finally:
        thread.join()


def test_disabled_publisher_releases_the_topic(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    block(xEnable=False)
    assert (Memory(topic)["writer"], block.xError, block.xBusy) == (0, False, False)
    assert demo.opened(topic).xSent


def test_blocks_enter_semaphores_without_waiting(demo: Demo) -> None:
    """Search the generated text for other time limits. The fixtures count waits at run time."""
    for path, text in demo.texts.items():
        if path.endswith(".st"):
            assert set(re.findall(r"SysSemProcessEnter\(\w+, ([^)]+)\)", text)) <= {"0"}, path
