"""That a cycle never waits, as numbers: at most so many instructions and system calls for each call in each state."""

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
"""Numbers of Linux on x86-64, as below; futex only to wake."""


class Bound(NamedTuple):
    """`calls` are the system calls that may be made, each as often as it stands there."""

    instructions: int
    calls: tuple[int, ...] = ()

    def holds(self, found: Counted) -> bool:
        allowed = all(found.calls.count(call) <= self.calls.count(call) for call in found.calls)
        return allowed and found.instructions <= self.instructions


DEFINITIONS = {
    **{f"demo_msgs/msg/{name}.msg": text for name, text in MESSAGES.items()},
    "demo_msgs/srv/Ask.srv": "uint32 a\n---\nuint32 b\n",
}
RECOVERS = (FCNTL, KILL, FCNTL)
CHECKS = (STAT,)
"""Whether the region's file is still there: once in REMOVED_MS."""
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
    ("is_stale", "usual"): Bound(220, CHECKS),  # of one that is
}
CALLS = {
    ("send",): Bound(500, CHECKS),
    ("poll",): Bound(200, CHECKS),
    ("send", "take"): Bound(650, 2 * CHECKS),
    ("send", "take", "reply"): Bound(750, CHECKS),
    ("send", "take", "reply", "poll"): Bound(250, CHECKS),
    ("take",): Bound(550, 2 * CHECKS),
}
"""Of a service in C; the last call of each row is counted."""
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
"""One cycle of a block that calls or serves, wherever the call stands."""
TRANSLATED = Bound(12_000)
"""Of Structured Text, compiled by the tests' own means and not optimised."""
OPENING = 60_000, 40
"""Instructions and system calls in one cycle of an open PLC's block."""
FILES = (1, 3, 8, 17, 86, 87, 91, 93, 257, STAT, 285)
MEMORY = (9, 10, 11, 12, 28)
WHO = (39, 102, 104, 107, 108, 115, 186, 318)
OPENS = {*FILES, *MEMORY, *WHO, FCNTL, FUTEX}
"""What it calls: nothing that sleeps, asks a service, or reads a file in parts, as who looks up a group does."""


def bring(state: str, topic: str, publish: Callable[[], object]) -> None:
    """Brings a topic, whose newest sample is read, into a state."""
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
        with subprocess.Popen(["true"]) as gone:
            pass
        memory["lock_holder"] = gone.pid
        publish()
        time.sleep((abi.DEAD_MS + 10) / 1000)


def bounded(found: Counted, bound: Bound) -> None:
    print(found)
    assert bound.holds(found), f"{found}, and {bound} is what it may take"


# --- C and C++ --------------------------------------------------------------------------------------------------


def compiled(folder: Path, plant: str = "") -> ctypes.CDLL:
    """C and C++ in one shared object; `plant` stands in front of each write."""
    if not shutil.which("g++"):
        pytest.skip("g++ is not installed")
    cpp_peer.generate(folder, DEFINITIONS)
    for header in folder.glob("*/*/shmgen_publisher.h"):
        header.write_text(planted(header.read_text(), plant))
    sources = [cpp_peer.HERE / name for name in ("cycle.c", "cycle_cpp.cpp")]
    return ctypes.CDLL(str(cpp_peer.compiled(folder, "cycle.so", *sources, options=["-fPIC", "-shared", "-O2"])))


def planted(text: str, plant: str) -> str:
    place = "    SHMGEN_COPY(payload, message, size);\n"
    assert place in text
    return text.replace(place, f"    {plant}\n{place}")


SLEEP = "shmgen_pause(10 * SHMGEN_MS);"


@pytest.fixture(scope="module")
def cycles(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return compiled(tmp_path_factory.mktemp("cycle"))


class Ends:
    """Those of C or C++ on a topic, which have made each of their calls once."""

    def __init__(self, library: ctypes.CDLL, language: str, topic: str) -> None:
        self.library, self.language = library, language
        self.call("open", topic.encode())
        assert ctypes.c_int.in_dll(library, "said").value == 0
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
    made = Ends(cycles, str(request.param), topic)
    yield made
    made.call("close")


@pytest.mark.parametrize(("name", "state"), C)
def test_c_and_cpp(ends: Ends, topic: str, name: str, state: str) -> None:
    bring(state, topic, lambda: ends.call("try_publish"))
    bounded(ends.count(name), C[name, state])


@pytest.mark.parametrize("name", ["try_publish", "heartbeat", "try_read", "is_stale"])
def test_the_file_is_checked_once_in_a_while(ends: Ends, name: str) -> None:
    time.sleep((abi.REMOVED_MS + 20) / 1000)
    found = [ends.count(name) for _ in range(20)]
    assert found[0].calls == CHECKS
    assert () in [one.calls for one in found[1:]]


@pytest.mark.parametrize("ends", ["c"], indirect=True)
@pytest.mark.parametrize("names", CALLS, ids=" ".join)
def test_a_service_in_c(ends: Ends, names: tuple[str, ...]) -> None:
    for _ in range(2):
        for name in ("send", "take", "reply", "poll"):
            ends.call(name)
    for name in names[:-1]:
        ends.call(name)
    bounded(ends.count(names[-1]), CALLS[names])


@pytest.mark.parametrize("language", ["c", "cpp"])
@pytest.mark.slow
def test_a_sleep_in_c_is_found(tmp_path: Path, topic: str, language: str) -> None:
    ends = Ends(compiled(tmp_path, SLEEP), language, topic)
    assert not C["try_publish", "usual"].holds(ends.count("try_publish"))
    ends.call("close")


# --- function blocks of open PLCs -------------------------------------------------------------------------------


def program_of(folder: Path, compiler: str, group: str = "", plant: str = "") -> open_plc.Program:
    if shutil.which(open_plc.COMPILERS[compiler][0]) is None:
        pytest.skip(f"{open_plc.COMPILERS[compiler][0]} is not installed")
    build.put(DEFINITIONS, folder)
    targets = ("matiec", "openplc")
    config = Config(folder, source="jazzy", path=(folder,), targets=targets, regions=Regions(group=group))
    texts = pipeline.generate(config, ["demo_msgs/Demo", "demo_msgs/Ask"])
    if plant:
        texts["matiec/shm_msgs.h"] = planted(texts["matiec/shm_msgs.h"], plant)
    return open_plc.Program(open_plc.compiled(texts, compiler, folder))


@pytest.fixture(scope="module", params=open_plc.COMPILERS)
def program(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[open_plc.Program]:
    made = program_of(tmp_path_factory.mktemp("blocks"), str(request.param))
    yield made
    made.unload()


def cycle(block: Any) -> Counted:
    """What one call of a block takes."""
    return counted(getattr(block._library, f"call_{block._name}"), block.address)


def opened(program: open_plc.Program, topic: str) -> tuple[dict[str, Any], list[Counted]]:
    """A publisher and a subscriber, and what their cycles took until they were open."""
    ends = {
        end: program.block(f"FB_demo_msgs_Demo_{end}", xEnable=True, sTopic=topic)
        for end in ("publisher", "subscriber")
    }
    took = []
    for block in ends.values():
        deadline = time.monotonic() + 5
        took.append(cycle(block))
        while block.xBusy and time.monotonic() < deadline:
            time.sleep(0.005)
            took.append(cycle(block))
        assert not block.xBusy
        assert not block.xError
    return ends, took


@pytest.mark.slow
@pytest.mark.parametrize(("name", "state"), BLOCKS)
def test_blocks_of_open_plcs(program: open_plc.Program, topic: str, name: str, state: str) -> None:
    ends, _ = opened(program, topic)
    bring(state, topic, ends["publisher"])
    bounded(cycle(ends[name]), BLOCKS[name, state])


def cycles_that_open(path: Path, topic: str) -> list[Counted]:
    return opened(open_plc.Program(path), topic)[1]


def assert_that_it_opens(path: Path, topic: str) -> None:
    """Counted in a new process: sem_close goes through all semaphores of its own, and tests leave thousands open."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as alone:
        cycles = alone.submit(cycles_that_open, path, topic).result()
    for found in cycles:
        print(found)
        assert found.instructions <= OPENING[0]
        assert len(found.calls) <= OPENING[1]
        assert OPENS.issuperset(found.calls)


@pytest.mark.family("openplc-v4")
def test_no_cycle_in_which_a_block_opens_waits(program: open_plc.Program, topic: str) -> None:
    assert_that_it_opens(program.path, topic)


@pytest.mark.family("openplc-v4")
def test_calls_of_open_plcs(program: open_plc.Program, topic: str) -> None:
    """Three calls, the lock of the responses held in the last."""
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
                bounded(cycle(block), CALLING)
            server.xDone = server.xExecute
        assert client.xDone == 1
        client.xExecute = False
        for block in (client, server):
            bounded(cycle(block), CALLING)


@pytest.mark.slow
def test_no_cycle_looks_up_a_group(tmp_path: Path, topic: str) -> None:
    """Which may ask files, services and the network; the program has done so when it was loaded."""
    assert_that_it_opens(program_of(tmp_path, "beremiz", group="daemon").path, topic)


@pytest.mark.slow
def test_a_sleep_in_a_block_is_found(tmp_path: Path, topic: str) -> None:
    program = program_of(tmp_path, "beremiz", plant=SLEEP)
    ends, _ = opened(program, topic)
    assert not BLOCKS["publisher", "usual"].holds(cycle(ends["publisher"]))
    program.unload()


# --- Structured Text --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "state"), BLOCKS)
def test_blocks_in_structured_text(demo: Demo, topic: str, name: str, state: str) -> None:
    ends = {"publisher": demo.opened(topic), "subscriber": demo.subscriber(topic)()}
    bring(state, topic, ends["publisher"])
    block = ends[name]
    bounded(counted(demo.plc._calls[block._name, ""], block._address), TRANSLATED)
