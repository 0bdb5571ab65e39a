"""Generated blocks exchange samples with the Python runtime despite held locks and killed processes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import posix_ipc
import pytest

from shmgen.runtime.errors import RegionInUse

from ..conftest import REPOSITORY
from ..softplc import Block
from ..support.plc_demo import CLAIM, HEAL, Clock, Demo, Memory, semaphore

# --- the lock -----------------------------------------------------------------------------------------


@contextmanager
def hold_lock(topic: str) -> Iterator[posix_ipc.Semaphore]:
    lock = semaphore(topic)
    lock.acquire(0)
    yield lock
    lock.release()


def test_subscriber_skips_the_cycle_if_the_lock_is_held(demo: Demo, topic: str) -> None:
    with demo.python.DemoPublisher(topic, lock_timeout=0) as publisher:
        publisher.publish(demo.message(1))
        block = demo.subscriber(topic)()
        Memory(topic)["ordered"] = 0  # as on ARM, where stores may change their order
        with hold_lock(topic):
            publisher.publish(demo.message(2))
            for misses in range(1, 4):
                block()
                assert (block.xNewData, block.xValid, block.xError, block.Msg.a) == (False, True, False, 1)
                assert block.udiLockMisses == misses
        assert (block().Msg.a, block.udiMissed) == (2, 0)


def test_lock_is_not_needed_if_stores_stay_in_order(demo: Demo, topic: str) -> None:
    """Send and read samples while a process holds the lock. Blocks release only a lock that they acquired."""
    with demo.python.DemoSubscriber(f"{topic}/read") as subscriber, demo.python.DemoPublisher(topic) as publisher:
        block, writer = demo.subscriber(topic)(), demo.opened(f"{topic}/read")
        with hold_lock(topic), hold_lock(f"{topic}/read"):
            publisher.publish(demo.message(2))
            assert (block().xNewData, block.Msg.a, block.udiLockMisses) == (True, 2, 1)
            assert (writer().xSent, writer.udiLockMisses) == (True, 1)
            assert subscriber.read().a == writer.Msg.a
            assert (semaphore(topic).value, semaphore(f"{topic}/read").value) == (0, 0)
        assert (block().udiLockMisses, writer().udiLockMisses) == (1, 1)
        assert (semaphore(topic).value, semaphore(f"{topic}/read").value) == (1, 1)


def test_publisher_skips_the_cycle_if_the_lock_is_held(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    with hold_lock(topic):
        before = Memory(topic).bytes()
        assert (block().xSent, block.xError, block.udiLockMisses, block.udiSequence) == (False, False, 1, 1)
        assert Memory(topic).bytes()[192:] == before[192:]
        assert Memory(topic)["completed0"] == 1
    assert (block().xSent, block.udiSequence) == (True, 2)


def test_stuck_lock_is_recovered_after_a_second(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.opened(topic)
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
    lock.release()  # the former holder releases too: the value 2 is corrected to 1
    assert (block().xSent, lock.value) == (True, 1)


def test_lock_that_changes_hands_is_not_stuck(demo: Demo, clock: Clock, topic: str) -> None:
    block = demo.opened(topic)
    memory = Memory(topic)
    with hold_lock(topic) as lock:
        for _ in range(10):
            assert not block().xSent
            memory["lock_count"] += 1
            clock.add(HEAL - 1)
        assert (lock.value, memory["recoveries"]) == (0, 0)


# --- samples ------------------------------------------------------------------------------------------


def test_subscriber_reads_unread_samples_in_order(demo: Demo, topic: str) -> None:
    block = demo.subscriber(topic, xNewest=False, udiDepth=4)
    with demo.python.DemoPublisher(topic, depth=4) as publisher:
        publisher.publish(demo.message(1))
        publisher.publish(demo.message(2))
        assert drain(block) == [2]  # only the newest of the samples before the first read counts
        for number in range(3, 7):
            publisher.publish(demo.message(number))
        assert (drain(block), block.udiMissed) == ([3, 4, 5, 6], 0)
        for number in range(7, 30):
            publisher.publish(demo.message(number))
        assert (drain(block), block.udiMissed) == (list(range(22, 30)), 15)
        assert Memory(topic)["missed"] == 15


def drain(block: Block) -> list[int]:
    values = []
    while block().xNewData:
        assert block.Msg.b == 2 * block.Msg.a
        values.append(block.Msg.a)
    return values


def test_sequence_numbers_wrap_around(demo: Demo, topic: str) -> None:
    block = demo.subscriber(topic)()
    memory = Memory(topic)
    memory["completed0"] = 0xFFFFFFFD
    writer = demo.opened(topic)
    assert [writer.udiSequence, *(writer().udiSequence for _ in range(3))] == [0xFFFFFFFE, 0xFFFFFFFF, 2, 3]
    block(xEnable=False)
    assert block(xEnable=True).udiSequence == 3
    assert (writer().udiSequence, block().udiSequence, block.udiMissed) == (4, 4, 0)
    with demo.python.DemoSubscriber(topic) as subscriber:
        assert (subscriber.read().a, subscriber.sequence) == (0, 4)


@pytest.mark.parametrize("before", range(6))
def test_no_sample_is_lost_when_the_numbers_wrap_around(demo: Demo, topic: str, before: int) -> None:
    """Skip the numbers 0 to slots - 1 after the wrap-around, on both sides. The region has 8 slots here."""
    with demo.python.DemoPublisher(topic, depth=4):
        memory = Memory(topic)
        memory["completed0"] = 0xFFFFFFFF - before
    with (
        demo.python.DemoPublisher(topic, depth=4) as publisher,
        demo.python.DemoSubscriber(topic, depth=4) as subscriber,
    ):
        publisher.publish(demo.message(1))
        block = demo.subscriber(topic, xNewest=False, udiDepth=4)
        assert drain(block) == [sample.a for sample in subscriber.read_all()] == [1]
        never_written = subscriber.missed  # the number that the test wrote into `completed0`
        for number in range(2, 6):
            publisher.publish(demo.message(number))
        assert drain(block) == [sample.a for sample in subscriber.read_all()] == [2, 3, 4, 5]
        assert (block.udiMissed, subscriber.missed - never_written) == (0, 0)
        for number in range(6, 17):
            publisher.publish(demo.message(number))
        assert drain(block) == [sample.a for sample in subscriber.read_all()] == list(range(9, 17))
        assert (block.udiMissed, subscriber.missed - never_written) == (3, 3)


def test_sample_overwritten_during_a_read_is_dropped(demo: Demo, topic: str) -> None:
    region = demo.plc.block("FB_ShmRegion")
    with demo.python.DemoPublisher(topic) as publisher:
        size = demo.plc.sizes["ST_DEMO_MSGS_DEMO"]
        digest = demo.python.Demo._digest_
        settings = {"lwDigest": digest, "udiPayloadSize": size, "udiSizeOf": size, "udiDepth": 1}
        assert region.method("Init", sTopic=topic, sTypeName="demo_msgs/msg/Demo", **settings)
        assert region.method("Cycle")
        publisher.publish(demo.message(1))
        assert region.method("BeginRead", xNewest=True) != 0
        Memory(topic).poke(192 + 128 + 8, bytes(4))  # overwrite the sample, as a writer without the lock would
        assert region.method("EndRead") is False
        assert (region.udiSequence, semaphore(topic).value) == (0, 1)


def test_write_from_and_read_into_bypass_msg(demo: Demo, topic: str) -> None:
    """Copy directly between a variable and the region, and leave Msg of both blocks unchanged."""
    sent, read = demo.plc.structure("ST_demo_msgs_Demo"), demo.plc.structure("ST_demo_msgs_Demo")
    writer, reader = demo.opened(topic, xSend=False), demo.subscriber(topic)()
    before = writer.udiSequence
    sent.a, sent.tail_count, sent.tail[1] = 7, 2, -7
    assert writer.method("WriteFrom", pFrom=sent._address) is True
    assert (writer.xSent, writer().udiSequence, writer.Msg.a) == (True, before + 1, 0)
    assert reader.method("ReadInto", pTo=read._address) is True
    assert (read.a, read.tail_count, read.tail[1]) == (7, 2, -7)
    assert (reader().xNewData, reader.Msg.a, reader.udiSequence) == (False, 0, before + 1)
    assert reader.method("ReadInto", pTo=read._address) is False
    sent.tail_count = 4
    assert writer.method("WriteFrom", pFrom=sent._address) is False
    assert (writer().udiSequence, writer.xSent) == (before + 1, False)


def test_subscriber_becomes_stale_after_its_timeout(demo: Demo, clock: Clock, topic: str) -> None:
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


def test_publisher_wakes_a_waiting_reader(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    memory, event = Memory(topic), semaphore(topic, "-event")
    block()
    assert event.value == 0
    memory["armed"] = 1
    block()
    assert (memory["armed"], event.value) == (0, 1)
    block()
    assert event.value == 1


def test_topic_named_event_has_its_own_semaphore(demo: Demo, topic: str) -> None:
    outer, inner = demo.opened(topic), demo.opened(f"{topic}/event")
    assert (outer().xSent, inner().xSent, semaphore(f"{topic}/event").value) == (True, True, 1)


def test_fb_exit_closes_except_in_an_online_change(demo: Demo, topic: str) -> None:
    block = demo.opened(topic)
    region = block._fbRegion  # the runtime calls FB_Exit of each instance, also of inner instances
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
    """Start a process, wait until it prints `running`, and kill it at the end."""
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True, cwd=REPOSITORY) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "running\n"
            yield process
        finally:
            process.send_signal(signal.SIGKILL)


@pytest.mark.parametrize("attempt", range(3))
def test_last_sample_of_a_killed_python_is_read(demo: Demo, topic: str, attempt: int) -> None:
    with running("-c", WRITER, str(demo.library.parents[1] / "python"), topic):
        time.sleep(0.01 * attempt)
    memory = Memory(topic)
    if semaphore(topic).value == 0:  # the process died with the lock
        semaphore(topic).release()
    block = demo.subscriber(topic)()
    assert (block.xNewData, block.udiSequence) == (True, memory["completed0"])
    assert block.Msg.a == memory["completed0"] > 0
    assert block.Msg.b == 2 * block.Msg.a & 0xFFFFFFFF


def test_last_sample_of_a_killed_plc_is_read(demo: Demo, clock: Clock, topic: str) -> None:
    task = ["-m", "tests.softplc.task", str(demo.library), "FB_demo_msgs_Demo_Publisher", "--period", "0"]
    with running(*task, "--set", "xEnable=true", f'sTopic="{topic}"'), demo.python.DemoSubscriber(topic) as subscriber:
        assert subscriber.wait(10)  # the PLC watches the topic, claims it, and sends
        with pytest.raises(RegionInUse):
            demo.python.DemoPublisher(topic)
    memory = Memory(topic)
    if semaphore(topic).value == 0:
        semaphore(topic).release()
    with demo.python.DemoSubscriber(topic) as subscriber:
        assert (subscriber.read().label, subscriber.sequence) == ("hey", memory.newest)
    block = demo.subscriber(topic)()
    assert (block.Msg.label, block.udiSequence) == ("hey", memory.newest)
    writer = demo.opened(topic, after=CLAIM)
    assert (writer.xSent, writer.udiSequence) == (True, memory.newest)


def test_incomplete_write_is_not_read(demo: Demo, topic: str) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        publisher.publish(demo.message(1))
        memory = Memory(topic)
        slot = 192 + 128 * 0  # sample 2 goes into slot 0
        memory.poke(slot, b"\xff" * 8 + bytes(4) + b"\xff" * 28)
        block = demo.subscriber(topic)()
        assert (block.xNewData, block.Msg.a, block.Msg.b, block.udiSequence) == (True, 1, 2, 1)


def test_fast_writer_causes_no_torn_sample(demo: Demo, topic: str) -> None:
    last, new = 0, 0
    with running("-c", WRITER, str(demo.library.parents[1] / "python"), topic):
        block = demo.subscriber(topic)
        for _ in range(20_000):
            if block().xNewData:
                assert (block.Msg.b, block.Msg.a > last) == (2 * block.Msg.a, True)
                last, new = block.Msg.a, new + 1
    assert new > 10
