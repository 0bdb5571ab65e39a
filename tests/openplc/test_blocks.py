"""Blocks of the open dialects exchange samples with Python through real regions and handle errors as documented."""

from __future__ import annotations

import os
import random
import resource
import stat
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from shmgen import runtime
from shmgen.core import abi
from shmgen.core.model import Layouts, Regions, TypeName

from ..support import build, open_plc
from ..support.machine import slower
from ..support.open_plc import Instance, Program
from ..support.plc_demo import Memory, semaphore
from ..support.schemas import plain, random_message
from .conftest import MESSAGES, texts_of

Classes = Callable[[str], tuple[Any, Any, Any]]
ROLES = ("Publisher", "Subscriber")


def open_publisher(plc: Program, message: str, topic: str, **inputs: object) -> Instance:
    return call_until_open(plc.block(f"FB_demo_msgs_{message}_Publisher", xEnable=True, sTopic=topic, **inputs))


def open_subscriber(plc: Program, message: str, topic: str, **inputs: object) -> Instance:
    return call_until_open(plc.block(f"FB_demo_msgs_{message}_Subscriber", xEnable=True, sTopic=topic, **inputs))


def call_until_open(block: Any, within: float = 30.0) -> Any:
    """Call a block in a loop, as PLC cycles do, until it is open or reports an error."""
    end = time.monotonic() + within
    block()
    while block.xBusy and time.monotonic() < end:
        time.sleep(0.001)
        block()
    return block


def wait_until(condition: Callable[[], bool], within: float = 30.0) -> bool:
    """Return True once the condition is true. Do not evaluate it again then: a publisher sends with each call."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return False


@pytest.mark.parametrize("name", MESSAGES)
def test_messages_pass_unchanged_in_both_directions(
    plc: Program, python: Classes, generated: tuple[Path, dict[str, str], Layouts], topic: str, name: str
) -> None:
    _, layouts = generated[1:]
    layout = next(it for it in layouts.values() if it.name.short == f"demo_msgs/{name}")
    _, publisher_kind, subscriber_kind = python(name)
    with publisher_kind(f"{topic}/in") as writer, subscriber_kind(f"{topic}/out") as reader:
        subscriber = open_subscriber(plc, name, f"{topic}/in")
        publisher = open_publisher(plc, name, f"{topic}/out", xSend=False)
        for seed in range(20):
            message = random_message(layout, layouts, random.Random(seed))
            writer.publish(message)
            assert subscriber().xNewData
            subscriber.move(publisher)
            assert publisher(xSend=True).xSent
            assert plain(reader.read()) == plain(message)
        assert (subscriber.udiSequence, subscriber.udiMissed, subscriber.xValid) == (20, 0, 1)
        assert publisher.udiSequence in (20, 22), "two more if this process was stopped while it claimed the topic"
        assert not subscriber().xNewData


def test_publisher_block_starts_with_default_values(plc: Program, python: Classes, topic: str) -> None:
    kind, _, subscriber_kind = python("Given")
    publisher = open_publisher(plc, "Given", topic, xSend=False)
    with subscriber_kind(topic) as reader:
        publisher(xSend=True)
        assert plain(reader.read()) == plain(kind())


@pytest.mark.parametrize("silent", range(2))
def test_first_sample_is_complete_in_any_opening_call(plc: Program, python: Classes, topic: str, silent: int) -> None:
    """Send a complete first message, no matter in which of the opening calls xSend becomes TRUE."""
    kind, _, subscriber_kind = python("Given")
    for turn in ("creates the region", "opens the region"):
        publisher = plc.block("FB_demo_msgs_Given_Publisher", xEnable=True, sTopic=topic, xSend=False)
        for _ in range(silent):
            publisher()
        assert wait_until(lambda publisher=publisher: publisher(xSend=True).xSent == 1, within=20)
        with subscriber_kind(topic) as reader:
            assert plain(reader.read()) == plain(kind()), turn
        publisher(xEnable=False)


def test_subscriber_refuses_a_count_above_its_bound(
    plc: Program, python: Classes, generated: tuple[Path, dict[str, str], Layouts], topic: str
) -> None:
    """Refuse a count of 9 where the bound is 3, and accept the next sample. A faulty peer can write such a count."""
    kind, publisher_kind, _ = python("All")
    layout = next(it for it in generated[2].values() if it.name.short == "demo_msgs/All")
    offset = next(slot.offset for slot in layout.slots if slot.name == "texts_count")
    subscriber = open_subscriber(plc, "All", topic)
    with publisher_kind(topic) as writer:
        writer.publish(kind())
        memory = Memory(topic)
        slot_size = int.from_bytes(memory.bytes()[20:24], "little")
        at = abi.HEADER_SIZE + memory["completed0"] % memory["slots"] * slot_size + abi.SLOT_HEADER + offset
        memory.poke(at, bytes([9, 0, 0, 0]))
        subscriber()
        assert (subscriber.xNewData, subscriber.xError, subscriber.eErrorID, subscriber.udiRefused) == (0, 1, 52, 1)
        assert (subscriber().xError, subscriber.xValid) == (1, 0), "the error stays until a valid sample arrives"
        writer.publish(kind())
        subscriber()
        assert (subscriber.xNewData, subscriber.xError, subscriber.udiRefused, subscriber.xValid) == (1, 0, 1, 1)


def test_invalid_inputs_set_the_error_id(plc: Program, python: Classes, topic: str) -> None:
    for name, inputs, error in (
        ("", {}, 1),
        ("//no", {}, 2),
        (f"/{'n' * 79}", {"udiDepth": 0}, 4),
        (topic, {"udiDepth": 70000}, 4),
    ):
        block = open_subscriber(plc, "Number", name, **inputs)
        assert (block.eErrorID, block.xError, block.xBusy, block.xValid) == (error, 1, 0, 0)
    assert open_subscriber(plc, "Number", topic).eErrorID == 0
    assert open_subscriber(plc, "Number", topic, udiDepth=9).eErrorID in (12, 24), "another depth is another size"
    assert open_subscriber(plc, "Empty", topic).eErrorID == 22


def test_subscriber_returns_one_sample_per_call(plc: Program, python: Classes, topic: str) -> None:
    kind, publisher_kind, _ = python("Number")
    subscriber = open_subscriber(plc, "Number", topic, udiDepth=4, xNewest=False)
    with publisher_kind(topic, depth=4) as writer:
        for value in range(4):
            writer.publish(kind(value=value))
        assert [subscriber().udiSequence for _ in range(4)] == [1, 2, 3, 4]
        for value in range(20):
            writer.publish(kind(value=value))
        subscriber()
        assert (subscriber.xNewData, subscriber.udiMissed) == (1, 20 - 8)


def test_subscriber_reports_a_silent_writer_as_stale(plc: Program, python: Classes, topic: str) -> None:
    kind, publisher_kind, _ = python("Number")
    with publisher_kind(topic) as writer:
        subscriber = open_subscriber(plc, "Number", topic, tTimeout=0.05)
        writer.publish(kind(value=1))
        assert subscriber().xStale == 0
        assert wait_until(lambda: subscriber().xStale == 1)
        writer.heartbeat()
        assert (subscriber().xStale, subscriber.xValid) == (0, 1)


def test_publisher_without_xsend_sends_heartbeats(plc: Program, python: Classes, topic: str) -> None:
    publisher = open_publisher(plc, "Number", topic, xSend=False)
    memory = Memory(topic)
    before = memory["heartbeat"]
    for _ in range(3):
        assert publisher().xSent == 0
    assert (memory["heartbeat"] - before, memory["completed0"], memory["writer"]) == (3, 0, os.getpid())


def test_publisher_waits_while_another_publishes(plc: Program, python: Classes, topic: str) -> None:
    """Report error 40 while a block or Python publishes. Retry, and claim the topic once that publisher is closed."""
    _, publisher_kind, _ = python("Number")
    with publisher_kind(topic):
        publisher = open_publisher(plc, "Number", topic)
        assert (publisher.eErrorID, publisher.xError, publisher.xBusy, publisher.xSent) == (40, 1, 0, 0)
    assert wait_until(lambda: publisher().xSent == 1)
    assert publisher.eErrorID == 0
    second = open_publisher(plc, "Number", topic)
    assert second.eErrorID == 40
    publisher(xEnable=False)
    assert wait_until(lambda: second().xSent == 1)
    with pytest.raises(runtime.RegionInUse):
        publisher_kind(topic)


def test_publisher_stops_after_another_claims_its_topic(plc: Program, python: Classes, topic: str) -> None:
    publisher = open_publisher(plc, "Number", topic)
    assert publisher().xSent
    Memory(topic)["writer"] = 0xFFFFFFFF
    publisher()
    assert (publisher.xSent, publisher.eErrorID, publisher.xError) == (0, 40, 1)
    assert wait_until(lambda: publisher().xSent == 1), "the other writer is silent for a second"


def test_blocks_do_not_wait_for_a_held_lock(plc: Program, python: Classes, topic: str) -> None:
    """Return from each call at once while the lock is held, and recover the lock once it counts as stuck."""
    publisher, subscriber = open_publisher(plc, "Number", topic), open_subscriber(plc, "Number", topic)
    assert publisher().xSent
    semaphore(topic).acquire(0)
    longest, slept = 0.0, resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    for _ in range(200):
        before = time.thread_time()
        publisher(), subscriber()
        longest = max(longest, time.thread_time() - before)
    assert longest < 0.005
    assert resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - slept < 100, "the blocks slept"
    assert publisher.udiLockMisses >= 200
    assert wait_until(lambda: (publisher(), Memory(topic)["recoveries"])[1] == 1)
    assert publisher().xSent
    before_free = publisher.udiLockMisses
    assert publisher().udiLockMisses == before_free


def test_unloaded_program_leaves_no_files_or_mappings(shared: Path, topic: str) -> None:
    """Load and unload the program three times. Ignore an endpoint number that comes from retained memory."""
    for _ in range(3):
        program = Program(shared)
        publisher = open_publisher(program, "Number", topic, _udiEnd=77)
        subscriber = open_subscriber(program, "Number", topic, _udiEnd=1)
        assert publisher().xSent
        assert subscriber().xNewData
        assert len(list_resources(topic)) >= 5, "two regions, three semaphores, and two files"
        publisher(xEnable=False)
        assert (publisher.eErrorID, publisher.xBusy, publisher.xError) == (0, 0, 0)
        assert subscriber(xEnable=False).xValid == 0
        assert list_resources(topic) == [], "a disabled block keeps nothing open"
        call_until_open(publisher(xEnable=True))
        call_until_open(subscriber(xEnable=True))
        assert publisher().xSent
        assert subscriber().xNewData
        program.unload()
        assert list_resources(topic) == []


def test_endpoint_closes_when_its_task_ends(plc: Program, topic: str) -> None:
    """Close an endpoint with its task, because the shared object may stay loaded. The next task opens it again."""
    publisher, subscriber = (plc.block(f"FB_demo_msgs_Number_{role}", xEnable=True, sTopic=topic) for role in ROLES)
    for block in (publisher, subscriber):
        run_in_thread(call_until_open, block)
        assert block.xBusy == 0
    assert wait_until(lambda: list_resources(topic) == [], within=20), "join() can return before the thread has ended"
    assert call_until_open(publisher)().xSent
    assert call_until_open(subscriber).xValid


def test_endpoint_stays_open_if_each_call_has_its_own_thread(plc: Program, topic: str) -> None:
    publisher = plc.block("FB_demo_msgs_Number_Publisher", xEnable=True, sTopic=topic)
    assert wait_until(lambda: (run_in_thread(publisher), publisher.xSent == 1)[1], within=20)
    for _ in range(3):
        run_in_thread(publisher)
        assert publisher.xSent


def test_restarted_program_closes_its_old_endpoint(plc: Program, topic: str) -> None:
    """Let a publisher claim its topic again after Beremiz has restarted the program without loading it again."""
    publisher = open_publisher(plc, "Number", topic)
    before = len(list_resources(topic))
    publisher._udiEnd = 0
    assert call_until_open(publisher)().xSent
    assert len(list_resources(topic)) == before


def run_in_thread(call: Callable[..., object], *arguments: object) -> None:
    thread = threading.Thread(target=call, args=arguments)
    thread.start()
    thread.join()


def list_resources(topic: str) -> list[str]:
    """Return the mappings and open files of this process that belong to a topic."""
    maps = Path("/proc/self/maps").read_text().splitlines()
    files = [os.readlink(path) for path in Path("/proc/self/fd").iterdir() if path.is_symlink()]
    return [line for line in (*maps, *files) if topic.rpartition("/")[2] in line]


@pytest.mark.slow
def test_region_files_have_the_configured_mode(tmp_path: Path, topic: str) -> None:
    """Apply the mode of shmgen.toml despite the umask."""
    texts, _ = texts_of(tmp_path, {"Number": "uint32 value\n"}, regions=Regions(mode=0o640))
    program = Program(open_plc.compiled(texts, "beremiz", tmp_path))
    before = os.umask(0o077)
    try:
        assert open_publisher(program, "Number", topic)().xSent
    finally:
        os.umask(before)
    files = [path for path in Path("/dev/shm").iterdir() if topic.split("/")[-1] in path.name]
    assert [stat.S_IMODE(path.stat().st_mode) for path in files] == [0o640] * 2
    program.unload()


@pytest.mark.slow
def test_publisher_refuses_a_string_longer_than_its_bound(tmp_path: Path, topic: str) -> None:
    """Compare the length with the bound, because a STRING of matiec always holds 126 bytes."""
    messages = {"Short": "string<=4 text\n", "Long": "string<=9 text\n"}
    texts, _ = texts_of(tmp_path, messages, package="shm_short")
    program = Program(open_plc.compiled(texts, "beremiz", tmp_path, "shm_short"))
    build.put(texts, tmp_path)
    kind, publisher_kind, _ = build.classes(tmp_path, "shm_short", TypeName("demo_msgs", "msg", "Long"))
    _, _, subscriber_kind = build.classes(tmp_path, "shm_short", TypeName("demo_msgs", "msg", "Short"))
    subscriber = open_subscriber(program, "Long", f"{topic}/in")
    publisher = open_publisher(program, "Short", f"{topic}/out", xSend=False)
    with publisher_kind(f"{topic}/in") as writer, subscriber_kind(f"{topic}/out") as reader:
        for text, error in (("four", 0), ("fives", 53), ("", 0)):
            writer.publish(kind(text=text))
            assert subscriber().xNewData
            subscriber.move(publisher)
            publisher(xSend=True)
            assert (publisher.xSent, publisher.eErrorID) == (error == 0, error)
            read = reader.read()
            assert read is None if error else read.text == text
    program.unload()


def test_blocks_reopen_a_removed_region(plc: Program, python: Classes, topic: str) -> None:
    """Reopen the region in the block as well after Python has noticed that the file was removed."""
    region = Path("/dev/shm") / runtime.region_name(topic)
    _, publisher_kind, subscriber_kind = python("Number")
    for kind, block in ((publisher_kind, open_subscriber), (subscriber_kind, open_publisher)):
        with kind(topic) as end:
            other = block(plc, "Number", topic)
            region.unlink()
            deadline = time.monotonic() + 10 * slower
            arrived = False
            while time.monotonic() < deadline and not (arrived and region.exists()):
                known = region.exists()
                if kind is publisher_kind:
                    end.publish(end.message_type())
                    arrived = bool(other().xNewData) and known
                else:
                    other(xSend=True)
                    arrived = end.read() is not None and known
                time.sleep(0.01)
            assert arrived
            assert end.reopen_count == 1
            other(xEnable=False)
