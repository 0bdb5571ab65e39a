"""No call in a cycle waits: each stays below a limit of instructions and system calls in each state of the topic."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from shmgen.config import Config
from shmgen.core import abi
from shmgen.core.model import Regions
from shmgen.generator import pipeline

from .support import build, cpp_peer, open_plc
from .support.plc_demo import MESSAGES, Demo, Memory, semaphore
from .support.steps import Counted, counted

FCNTL, FUTEX, KILL, STAT = 72, 202, 62, 262
"""Numbers of system calls of Linux on x86-64, as below. futex is called only to wake."""


class Bound(NamedTuple):
    """The limits of one call. `calls` lists the allowed system calls, each as often as it may be called."""

    instructions: int
    calls: tuple[int, ...] = ()

    def holds(self, count: Counted) -> bool:
        allowed = all(count.calls.count(call) <= self.calls.count(call) for call in count.calls)
        return allowed and count.instructions <= self.instructions


DEFINITIONS = {
    **{f"demo_msgs/msg/{name}.msg": text for name, text in MESSAGES.items()},
    "demo_msgs/srv/Ask.srv": "uint32 a\n---\nuint32 b\n",
}
RECOVERS = (FCNTL, KILL, FCNTL)
CHECKS = (STAT,)
"""The check that the region's file still exists, once in REMOVED_MS."""
C = {
    ("try_publish", "usual"): Bound(450, CHECKS),
    ("try_publish", "a reader sleeps"): Bound(500, (*CHECKS, FUTEX)),
    ("try_publish", "the lock is held"): Bound(700, CHECKS),
    ("try_publish", "the lock is held by a dead process"): Bound(900, (*CHECKS, *RECOVERS)),
    ("misfit", "usual"): Bound(120),
    ("heartbeat", "usual"): Bound(180, CHECKS),
    ("try_read", "nothing new"): Bound(180, CHECKS),
    ("try_read", "a new sample"): Bound(350),
    ("try_read", "a new sample, the lock is held"): Bound(350),
    ("try_read", "a new sample, being overwritten"): Bound(1600),
    ("is_stale", "usual"): Bound(220, CHECKS),  # the subscriber is stale
}
CALLS = {
    ("send",): Bound(500, CHECKS),
    ("poll",): Bound(200, CHECKS),
    ("send", "take"): Bound(650, 2 * CHECKS),
    ("send", "take", "reply"): Bound(750, CHECKS),
    ("send", "take", "reply", "poll"): Bound(250, CHECKS),
    ("take",): Bound(550, 2 * CHECKS),
}
"""Limits for a service in C. Only the last call of each row is counted."""
BLOCKS = {
    ("publisher", "usual"): Bound(700, CHECKS),
    ("publisher", "a reader sleeps"): Bound(750, (*CHECKS, FUTEX)),
    ("publisher", "the lock is held"): Bound(900, CHECKS),
    ("publisher", "the lock is held by a dead process"): Bound(1100, (*CHECKS, *RECOVERS)),
    ("subscriber", "nothing new"): Bound(500, CHECKS),
    ("subscriber", "a new sample"): Bound(650),
    ("subscriber", "a new sample, the lock is held"): Bound(650),
    ("subscriber", "a new sample, being overwritten"): Bound(2100),
}
CALLING = Bound(1500, (*2 * CHECKS, FUTEX))
"""The limit of one cycle of a client's or server's block, in any state of the call."""
TRANSLATED = Bound(12_000)
"""The limit for Structured Text, which the soft PLC of the tests compiles without optimization."""
OPENING = 60_000, 40
"""Instructions and system calls in one cycle of an open PLC's block."""
FILES = (1, 3, 8, 17, 86, 87, 91, 93, 257, STAT, 285)
MEMORY = (9, 10, 11, 12, 28)
IDENTITY = (39, 102, 104, 107, 108, 115, 186, 318)
OPENS = {*FILES, *MEMORY, *IDENTITY, FCNTL, FUTEX}
"""System calls of a cycle that opens. None sleeps, connects to a service, or reads a file in parts."""


def bring_into_state(state: str, topic: str, publish: Callable[[], object]) -> None:
    """Bring a topic into a state. Its newest sample has been read before."""
    memory = Memory(topic)
    if "new sample" in state:
        publish()
    if "overwritten" in state:
        slot_size = int.from_bytes(memory.bytes()[20:24], "little")
        for slot in range(abi.LANES * memory["slots"]):
            memory.poke(abi.HEADER_SIZE + slot * slot_size + 8, bytes(4))
    if "sleeps" in state:
        memory["armed"] = 1
    if "held" in state:
        semaphore(topic).acquire(0)
    if "dead" in state:
        with subprocess.Popen(["true"]) as ended:
            pass
        memory["lock_holder"] = ended.pid
        publish()
        time.sleep((abi.DEAD_MS + 10) / 1000)


def assert_bounded(count: Counted, bound: Bound) -> None:
    print(count)
    assert bound.holds(count), f"{count}, but the limit is {bound}"


# --- C and C++ --------------------------------------------------------------------------------------------------


def compile_library(folder: Path, plant: str = "") -> ctypes.CDLL:
    """Compile C and C++ into one shared library. The code in `plant` is inserted before each write."""
    if not shutil.which("g++"):
        pytest.skip("g++ is not installed")
    cpp_peer.generate(folder, DEFINITIONS)
    for header in folder.glob("*/*/shmgen_publisher.h"):
        header.write_text(with_planted_code(header.read_text(), plant))
    sources = [cpp_peer.HERE / name for name in ("cycle.c", "cycle_cpp.cpp")]
    return ctypes.CDLL(str(cpp_peer.compiled(folder, "cycle.so", *sources, options=["-fPIC", "-shared", "-O2"])))


def with_planted_code(text: str, plant: str) -> str:
    place = "    SHMGEN_COPY(payload, message, size);\n"
    assert place in text
    return text.replace(place, f"    {plant}\n{place}")


SLEEP = "shmgen_pause(10 * SHMGEN_MS);"


@pytest.fixture(scope="module")
def cycles(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return compile_library(tmp_path_factory.mktemp("cycle"))


class Ends:
    """The publisher and subscriber in C or C++ on a topic. Each of their functions has been called once."""

    def __init__(self, library: ctypes.CDLL, language: str, topic: str) -> None:
        self.library, self.language = library, language
        self.call("open", topic.encode())
        assert ctypes.c_int.in_dll(library, "last_status").value == 0
        for name, _ in C:
            self.call(name)

    def call(self, name: str, *words: object) -> None:
        self._function(name)(*words)

    def count(self, name: str) -> Counted:
        return counted(self._function(name))

    def _function(self, name: str) -> Any:
        return getattr(self.library, f"{self.language}_{name}")


@pytest.fixture(params=["c", "cpp"])
def ends(cycles: ctypes.CDLL, request: pytest.FixtureRequest, topic: str) -> Iterator[Ends]:
    pair = Ends(cycles, str(request.param), topic)
    yield pair
    pair.call("close")


@pytest.mark.parametrize(("name", "state"), C)
@pytest.mark.slow
def test_c_and_cpp_stay_within_limits(ends: Ends, topic: str, name: str, state: str) -> None:
    bring_into_state(state, topic, lambda: ends.call("try_publish"))
    assert_bounded(ends.count(name), C[name, state])


@pytest.mark.parametrize("name", ["try_publish", "heartbeat", "try_read", "is_stale"])
@pytest.mark.slow
def test_region_file_is_checked_at_an_interval(ends: Ends, name: str) -> None:
    time.sleep((abi.REMOVED_MS + 20) / 1000)
    counts = [ends.count(name) for _ in range(20)]
    assert counts[0].calls == CHECKS
    assert () in [count.calls for count in counts[1:]]


@pytest.mark.parametrize("ends", ["c"], indirect=True)
@pytest.mark.parametrize("names", CALLS, ids=" ".join)
def test_service_in_c_stays_within_limits(ends: Ends, names: tuple[str, ...]) -> None:
    for _ in range(2):
        for name in ("send", "take", "reply", "poll"):
            ends.call(name)
    for name in names[:-1]:
        ends.call(name)
    assert_bounded(ends.count(names[-1]), CALLS[names])


@pytest.mark.parametrize("language", ["c", "cpp"])
@pytest.mark.sample("[c]")
def test_sleep_planted_in_c_exceeds_the_limit(tmp_path: Path, topic: str, language: str) -> None:
    ends = Ends(compile_library(tmp_path, SLEEP), language, topic)
    assert not C["try_publish", "usual"].holds(ends.count("try_publish"))
    ends.call("close")


# --- function blocks of open PLCs -------------------------------------------------------------------------------


def build_program(folder: Path, compiler: str, group: str = "", plant: str = "") -> open_plc.Program:
    if shutil.which(open_plc.COMPILERS[compiler][0]) is None:
        pytest.skip(f"{open_plc.COMPILERS[compiler][0]} is not installed")
    build.put(DEFINITIONS, folder)
    targets = ("matiec", "openplc")
    config = Config(folder, source="jazzy", path=(folder,), targets=targets, regions=Regions(group=group))
    texts = pipeline.generate(config, ["demo_msgs/Demo", "demo_msgs/Ask"])
    if plant:
        texts["matiec/shm_msgs.h"] = with_planted_code(texts["matiec/shm_msgs.h"], plant)
    return open_plc.Program(open_plc.compiled(texts, compiler, folder))


@pytest.fixture(scope="module", params=open_plc.COMPILERS)
def program(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[open_plc.Program]:
    loaded = build_program(tmp_path_factory.mktemp("blocks"), str(request.param))
    yield loaded
    loaded.unload()


def cycle(block: Any) -> Counted:
    """Call a block once. Return its instructions and system calls."""
    return counted(getattr(block._library, f"call_{block._name}"), block.address)


def open_blocks(program: open_plc.Program, topic: str) -> tuple[dict[str, Any], list[Counted]]:
    """Open a publisher and a subscriber. Return both, and the counts of their cycles until they were open."""
    ends = {
        end: program.block(f"FB_demo_msgs_Demo_{end}", xEnable=True, sTopic=topic)
        for end in ("publisher", "subscriber")
    }
    opening = []
    for block in ends.values():
        deadline = time.monotonic() + 5
        opening.append(cycle(block))
        while block.xBusy and time.monotonic() < deadline:
            time.sleep(0.005)
            opening.append(cycle(block))
        assert not block.xBusy
        assert not block.xError
    return ends, opening


@pytest.mark.sample("[openplc-v4-")
@pytest.mark.parametrize(("name", "state"), BLOCKS)
def test_open_plc_blocks_stay_within_limits(program: open_plc.Program, topic: str, name: str, state: str) -> None:
    ends, _ = open_blocks(program, topic)
    bring_into_state(state, topic, ends["publisher"])
    assert_bounded(cycle(ends[name]), BLOCKS[name, state])


def count_opening_cycles(path: Path, topic: str) -> list[Counted]:
    return open_blocks(open_plc.Program(path), topic)[1]


def assert_opening_is_bounded(path: Path, topic: str) -> None:
    """Count in a new process: sem_close visits all open semaphores of a process, and the tests leave thousands open."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
        cycles = alone.submit(count_opening_cycles, path, topic).result()
    for count in cycles:
        print(count)
        assert count.instructions <= OPENING[0]
        assert len(count.calls) <= OPENING[1]
        assert OPENS.issuperset(count.calls)


@pytest.mark.family("openplc-v4")
def test_block_does_not_wait_while_it_opens(program: open_plc.Program, topic: str) -> None:
    assert_opening_is_bounded(program.path, topic)


@pytest.mark.family("openplc-v4")
def test_open_plc_service_calls_stay_within_limits(program: open_plc.Program, topic: str) -> None:
    """Call three times. During the last call, the lock of the responses is held."""
    client, server = (
        program.block(f"FB_demo_msgs_Ask_{end}", xEnable=True, sService=topic) for end in ("Client", "Server")
    )
    for _ in range(100):
        client(), server()
        time.sleep(0.002)
    for call in range(3):
        client.xExecute = True
        for turn in range(6):
            if (call, turn) == (2, 2):
                semaphore(topic, "-response").acquire(0)
            for block in (server, client):
                assert_bounded(cycle(block), CALLING)
            server.xDone = server.xExecute
        assert client.xDone == 1
        client.xExecute = False
        for block in (client, server):
            assert_bounded(cycle(block), CALLING)


@pytest.mark.slow
def test_no_cycle_looks_up_a_group_name(tmp_path: Path, topic: str) -> None:
    """Look up the group when the program is loaded, because a lookup may read files and wait for the network."""
    assert_opening_is_bounded(build_program(tmp_path, "beremiz", group="daemon").path, topic)


@pytest.mark.slow
def test_sleep_planted_in_a_block_exceeds_the_limit(tmp_path: Path, topic: str) -> None:
    program = build_program(tmp_path, "beremiz", plant=SLEEP)
    ends, _ = open_blocks(program, topic)
    assert not BLOCKS["publisher", "usual"].holds(cycle(ends["publisher"]))
    program.unload()


# --- Structured Text --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "state"), BLOCKS)
def test_blocks_in_structured_text_stay_within_limits(demo: Demo, topic: str, name: str, state: str) -> None:
    ends = {"publisher": demo.opened(topic), "subscriber": demo.subscriber(topic)()}
    bring_into_state(state, topic, ends["publisher"])
    block = ends[name]
    assert_bounded(counted(demo.plc._calls[block._name, ""], block._address), TRANSLATED)
