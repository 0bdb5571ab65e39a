"""Blocks of the open dialects against Python, through real regions: values, and how a block behaves."""

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
ENDS = ("Publisher", "Subscriber")


def publisher(plc: Program, message: str, topic: str, **inputs: object) -> Instance:
    return ready(plc.block(f"FB_demo_msgs_{message}_Publisher", xEnable=True, sTopic=topic, **inputs))


def subscriber(plc: Program, message: str, topic: str, **inputs: object) -> Instance:
    return ready(plc.block(f"FB_demo_msgs_{message}_Subscriber", xEnable=True, sTopic=topic, **inputs))


def ready(block: Any, within: float = 30.0) -> Any:
    """Called as a cycle would, until it is open or says why not."""
    end = time.monotonic() + within
    block()
    while block.xBusy and time.monotonic() < end:
        time.sleep(0.001)
        block()
    return block


def until(said: Callable[[], bool], within: float = 30.0) -> bool:
    """Whether it was said in time; not asked again then, since a publisher sends with each call."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        if said():
            return True
        time.sleep(0.005)
    return False


@pytest.mark.parametrize("name", MESSAGES)
def test_all_kinds_of_fields_there_and_back(
    plc: Program, python: Classes, generated: tuple[Path, dict[str, str], Layouts], topic: str, name: str
) -> None:
    _, layouts = generated[1:]
    layout = next(it for it in layouts.values() if it.name.short == f"demo_msgs/{name}")
    _, publisher_kind, subscriber_kind = python(name)
    with publisher_kind(f"{topic}/in") as to, subscriber_kind(f"{topic}/out") as back:
        heard = subscriber(plc, name, f"{topic}/in")
        said = publisher(plc, name, f"{topic}/out", xSend=False)
        for seed in range(20):
            message = random_message(layout, layouts, random.Random(seed))
            to.publish(message)
            assert heard().xNewData
            heard.move(said)
            assert said(xSend=True).xSent
            assert plain(back.read()) == plain(message)
        assert (heard.udiSequence, heard.udiMissed, heard.xValid) == (20, 0, 1)
        assert said.udiSequence in (20, 22), "two more where this process stood still while it claimed the topic"
        assert not heard().xNewData


def test_a_block_begins_with_the_defaults(plc: Program, python: Classes, topic: str) -> None:
    kind, _, subscriber_kind = python("Given")
    said = publisher(plc, "Given", topic, xSend=False)
    with subscriber_kind(topic) as reader:
        said(xSend=True)
        assert plain(reader.read()) == plain(kind())


@pytest.mark.parametrize("silent", range(2))
def test_the_first_sample_is_whole_whichever_call_opens(plc: Program, python: Classes, topic: str, silent: int) -> None:
    """Opening takes a few calls, and xSend is TRUE from any of them on: in the one that ends it there is a message."""
    kind, _, subscriber_kind = python("Given")
    for turn in ("makes the region", "finds it"):
        said = plc.block("FB_demo_msgs_Given_Publisher", xEnable=True, sTopic=topic, xSend=False)
        for _ in range(silent):
            said()
        assert until(lambda said=said: said(xSend=True).xSent == 1, within=20)
        with subscriber_kind(topic) as reader:
            assert plain(reader.read()) == plain(kind()), turn
        said(xEnable=False)


def test_a_count_above_its_bound_is_refused(
    plc: Program, python: Classes, generated: tuple[Path, dict[str, str], Layouts], topic: str
) -> None:
    """A peer in C, or damage, has written 9 of 3; the next sample is taken again."""
    kind, publisher_kind, _ = python("All")
    layout = next(it for it in generated[2].values() if it.name.short == "demo_msgs/All")
    offset = next(slot.offset for slot in layout.slots if slot.name == "texts_count")
    heard = subscriber(plc, "All", topic)
    with publisher_kind(topic) as writer:
        writer.publish(kind())
        memory = Memory(topic)
        slot_size = int.from_bytes(memory.bytes()[20:24], "little")
        at = abi.HEADER_SIZE + memory["completed0"] % memory["slots"] * slot_size + abi.SLOT_HEADER + offset
        memory.poke(at, bytes([9, 0, 0, 0]))
        heard()
        assert (heard.xNewData, heard.xError, heard.eErrorID, heard.udiRefused) == (0, 1, 52, 1)
        assert (heard().xError, heard.xValid) == (1, 0), "it stays until one fits"
        writer.publish(kind())
        heard()
        assert (heard.xNewData, heard.xError, heard.udiRefused, heard.xValid) == (1, 0, 1, 1)


def test_settings_that_cannot_work_are_told(plc: Program, python: Classes, topic: str) -> None:
    for name, inputs, error in (
        ("", {}, 1),
        ("//no", {}, 2),
        (f"/{'n' * 79}", {"udiDepth": 0}, 4),
        (topic, {"udiDepth": 70000}, 4),
    ):
        block = subscriber(plc, "Number", name, **inputs)
        assert (block.eErrorID, block.xError, block.xBusy, block.xValid) == (error, 1, 0, 0)
    assert subscriber(plc, "Number", topic).eErrorID == 0
    assert subscriber(plc, "Number", topic, udiDepth=9).eErrorID in (12, 24), "another depth is another size"
    assert subscriber(plc, "Empty", topic).eErrorID == 22


def test_every_sample_one_a_call(plc: Program, python: Classes, topic: str) -> None:
    kind, publisher_kind, _ = python("Number")
    heard = subscriber(plc, "Number", topic, udiDepth=4, xNewest=False)
    with publisher_kind(topic, depth=4) as writer:
        for value in range(4):
            writer.publish(kind(value=value))
        assert [heard().udiSequence for _ in range(4)] == [1, 2, 3, 4]
        for value in range(20):
            writer.publish(kind(value=value))
        heard()
        assert (heard.xNewData, heard.udiMissed) == (1, 20 - 8)


def test_a_writer_that_is_silent_is_told(plc: Program, python: Classes, topic: str) -> None:
    kind, publisher_kind, _ = python("Number")
    with publisher_kind(topic) as writer:
        heard = subscriber(plc, "Number", topic, tTimeout=0.05)
        writer.publish(kind(value=1))
        assert heard().xStale == 0
        assert until(lambda: heard().xStale == 1)
        writer.heartbeat()
        assert (heard().xStale, heard.xValid) == (0, 1)


def test_a_block_that_sends_nothing_still_lives(plc: Program, python: Classes, topic: str) -> None:
    said = publisher(plc, "Number", topic, xSend=False)
    memory = Memory(topic)
    before = memory["heartbeat"]
    for _ in range(3):
        assert said().xSent == 0
    assert (memory["heartbeat"] - before, memory["completed0"], memory["writer"]) == (3, 0, os.getpid())


def test_one_writer_a_topic(plc: Program, python: Classes, topic: str) -> None:
    """Another block, or Python: told, tried again twice a second, and taken over when the other has gone."""
    _, publisher_kind, _ = python("Number")
    with publisher_kind(topic):
        said = publisher(plc, "Number", topic)
        assert (said.eErrorID, said.xError, said.xBusy, said.xSent) == (40, 1, 0, 0)
    assert until(lambda: said().xSent == 1)
    assert said.eErrorID == 0
    second = publisher(plc, "Number", topic)
    assert second.eErrorID == 40
    said(xEnable=False)
    assert until(lambda: second().xSent == 1)
    with pytest.raises(runtime.RegionInUse):
        publisher_kind(topic)


def test_a_block_whose_topic_was_taken_gives_way(plc: Program, python: Classes, topic: str) -> None:
    said = publisher(plc, "Number", topic)
    assert said().xSent
    Memory(topic)["writer"] = 0xFFFFFFFF
    said()
    assert (said.xSent, said.eErrorID, said.xError) == (0, 40, 1)
    assert until(lambda: said().xSent == 1), "the other one is silent for a second"


def test_nothing_waits_for_a_lock_that_somebody_holds(plc: Program, python: Classes, topic: str) -> None:
    """And a lock whose holder is dead is freed; on a machine that keeps its stores in order samples go on meanwhile."""
    said, heard = publisher(plc, "Number", topic), subscriber(plc, "Number", topic)
    assert said().xSent
    semaphore(topic).acquire(0)
    longest, slept = 0.0, resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    for _ in range(200):
        before = time.thread_time()
        said(), heard()
        longest = max(longest, time.thread_time() - before)
    assert longest < 0.005
    assert resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - slept < 100, "they sleep"
    assert said.udiLockMisses >= 200
    assert until(lambda: (said(), Memory(topic)["recoveries"])[1] == 1)
    assert said().xSent
    before_free = said.udiLockMisses
    assert said().udiLockMisses == before_free


def test_nothing_is_left_mapped_when_the_program_is_unloaded(shared: Path, topic: str) -> None:
    """Nor open; and the program comes again. A number out of retained memory is not believed."""
    for _ in range(3):
        program = Program(shared)
        said = publisher(program, "Number", topic, _udiEnd=77)
        heard = subscriber(program, "Number", topic, _udiEnd=1)
        assert said().xSent
        assert heard().xNewData
        assert len(held(topic)) >= 5, "two regions, three semaphores, and two files"
        said(xEnable=False)
        assert (said.eErrorID, said.xBusy, said.xError) == (0, 0, 0)
        assert heard(xEnable=False).xValid == 0
        assert held(topic) == [], "a block that is not enabled holds nothing"
        ready(said(xEnable=True))
        ready(heard(xEnable=True))
        assert said().xSent
        assert heard().xNewData
        program.unload()
        assert held(topic) == []


def test_an_end_goes_with_the_task_that_opened_it(plc: Program, topic: str) -> None:
    """Which ends with the program, while the shared object may stay loaded; then whoever goes on opens it again."""
    said, heard = (plc.block(f"FB_demo_msgs_Number_{end}", xEnable=True, sTopic=topic) for end in ENDS)
    for block in (said, heard):
        in_a_thread(ready, block)
        assert block.xBusy == 0
    assert until(lambda: held(topic) == [], within=20), "join() does not wait for all of the thread's end"
    assert ready(said)().xSent
    assert ready(heard).xValid


def test_an_end_stays_where_each_call_has_a_thread_of_its_own(plc: Program, topic: str) -> None:
    said = plc.block("FB_demo_msgs_Number_Publisher", xEnable=True, sTopic=topic)
    assert until(lambda: (in_a_thread(said), said.xSent == 1)[1], within=20)
    for _ in range(3):
        in_a_thread(said)
        assert said.xSent


def test_a_block_with_first_values_again_closes_what_it_had_open(plc: Program, topic: str) -> None:
    """Beremiz starts a program again without loading it again: a publisher must not be kept out by itself."""
    said = publisher(plc, "Number", topic)
    before = len(held(topic))
    said._udiEnd = 0
    assert ready(said)().xSent
    assert len(held(topic)) == before


def in_a_thread(call: Callable[..., object], *given: object) -> None:
    thread = threading.Thread(target=call, args=given)
    thread.start()
    thread.join()


def held(topic: str) -> list[str]:
    """What this process has mapped or open of it."""
    maps = Path("/proc/self/maps").read_text().splitlines()
    files = [os.readlink(path) for path in Path("/proc/self/fd").iterdir() if path.is_symlink()]
    return [line for line in (*maps, *files) if topic.rpartition("/")[2] in line]


@pytest.mark.slow
def test_files_are_those_of_the_settings(tmp_path: Path, topic: str) -> None:
    """Mode and group of shmgen.toml, whatever the umask; root makes them for others."""
    texts, _ = texts_of(tmp_path, {"Number": "uint32 value\n"}, regions=Regions(mode=0o640))
    program = Program(open_plc.compiled(texts, "beremiz", tmp_path))
    before = os.umask(0o077)
    try:
        assert publisher(program, "Number", topic)().xSent
    finally:
        os.umask(before)
    generated = [path for path in Path("/dev/shm").iterdir() if topic.split("/")[-1] in path.name]
    assert [stat.S_IMODE(path.stat().st_mode) for path in generated] == [0o640] * 2
    program.unload()


@pytest.mark.slow
def test_a_text_longer_than_its_bound_is_refused(tmp_path: Path, topic: str) -> None:
    """matiec's STRING holds 126 bytes whatever the definition says, so that the two messages are one to it."""
    messages = {"Short": "string<=4 text\n", "Long": "string<=9 text\n"}
    texts, _ = texts_of(tmp_path, messages, package="shm_short")
    program = Program(open_plc.compiled(texts, "beremiz", tmp_path, "shm_short"))
    build.put(texts, tmp_path)
    kind, publisher_kind, _ = build.classes(tmp_path, "shm_short", TypeName("demo_msgs", "msg", "Long"))
    _, _, subscriber_kind = build.classes(tmp_path, "shm_short", TypeName("demo_msgs", "msg", "Short"))
    heard = subscriber(program, "Long", f"{topic}/in")
    said = publisher(program, "Short", f"{topic}/out", xSend=False)
    with publisher_kind(f"{topic}/in") as writer, subscriber_kind(f"{topic}/out") as reader:
        for text, error in (("four", 0), ("fives", 53), ("", 0)):
            writer.publish(kind(text=text))
            assert heard().xNewData
            heard.move(said)
            said(xSend=True)
            assert (said.xSent, said.eErrorID) == (error == 0, error)
            read = reader.read()
            assert read is None if error else read.text == text
    program.unload()


def test_blocks_go_on_after_rm(plc: Program, python: Classes, topic: str) -> None:
    """Python notices it for both, and the blocks reopen the region."""
    region = Path("/dev/shm") / runtime.region_name(topic)
    _, publisher_kind, subscriber_kind = python("Number")
    for kind, block in ((publisher_kind, subscriber), (subscriber_kind, publisher)):
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
