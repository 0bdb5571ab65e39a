"""Measures the seconds from the kill of a process that holds the lock until all others continue.

    python -m tests.rigs.takeover [--tries 1]

A row is a pair of the process that dies and the writer that continues. A reader in Python and one in the simulated PLC
also run. If a reader dies, the writer runs before and after the kill. If a writer dies, the next writer starts at this
moment, or has already waited for the topic (`standby`). `needs the lock` is Python on a machine on which the lock is
mandatory. The exit code is 1 if a pair took longer than 1.3 s in all tries.
"""

from __future__ import annotations

import argparse
import ctypes
import mmap
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from shmgen.runtime import LockTimeout, RegionMissing, read_header, region_name
from shmgen.runtime.reference import lock, writer
from shmgen.runtime.region import header as h

from ..support import plc_demo
from ..support.engines import in_python
from .chaos_faults import Wrapped, swap, swap_map

LIMIT = 1.3
PERIOD = 0.001
"""Seconds; the cycle of the PLC."""

Play = Callable[[Any, str, Callable[[], None]], None]
"""Works on a topic of a Demo for ever, and calls back for each sample, or once it is inside the lock."""


def python_writer(demo: Any, topic: str, moved: Callable[[], None]) -> None:
    with demo.python.DemoPublisher(topic) as publisher:
        while True:
            with suppress(LockTimeout):
                publisher.publish(demo.message(1))
                moved()
            time.sleep(PERIOD)


def python_writer_in_need(demo: Any, topic: str, moved: Callable[[], None]) -> None:
    """Publish with the reference as on a machine that is not x86, where the lock is mandatory."""
    for module in (lock, writer):
        module.keeps_order = lambda: False
    with in_python():
        python_writer(demo, topic, moved)


def python_reader(demo: Any, topic: str, moved: Callable[[], None]) -> None:
    with demo.python.DemoSubscriber(topic) as subscriber:
        while True:
            if subscriber.wait(1.0):
                moved()


def plc_writer(demo: Any, topic: str, moved: Callable[[], None]) -> None:
    block = demo.publisher(topic)
    while True:
        if block().xSent:
            moved()
        time.sleep(PERIOD)


def plc_reader(demo: Any, topic: str, moved: Callable[[], None]) -> None:
    block = demo.subscriber(topic)
    while True:
        if block().xNewData:
            moved()
        time.sleep(PERIOD)


def python_writer_inside(demo: Any, topic: str, inside: Callable[[], None]) -> None:
    """Publish for a while, so that a writer on standby keeps waiting. Then call `inside` in the middle of a copy."""
    with in_python(), demo.python.DemoPublisher(topic) as publisher:
        for _ in range(20):
            publisher.publish(demo.message(1))
            time.sleep(PERIOD)
        swap_map(publisher, inside)
        publisher.publish(demo.message(2))


def python_reader_inside(demo: Any, topic: str, inside: Callable[[], None]) -> None:
    class Words(Wrapped):
        def __getitem__(self, where: int) -> Any:
            if where >= h.HEADER_SIZE // 4:
                inside()
            return self.inner[where]

    with in_python(), demo.python.DemoSubscriber(topic) as subscriber:
        swap(subscriber, "words", Words)
        while True:
            subscriber.wait(1.0)


def plc_writer_inside(demo: Any, topic: str, inside: Callable[[], None]) -> None:
    region = _region(demo, topic, writer=True)
    for _ in range(20):
        if region.method("BeginWrite"):
            region.method("EndWrite")
        time.sleep(PERIOD)
        region.method("Cycle")
    while not region.method("BeginWrite"):
        region.method("Cycle")
    inside()


def plc_reader_inside(demo: Any, topic: str, inside: Callable[[], None]) -> None:
    region = _region(demo, topic, writer=False)
    while not region.method("BeginRead", xNewest=True):
        region.method("Cycle")
    inside()


def _region(demo: Any, topic: str, writer: bool) -> Any:
    kind = demo.python.Demo
    region = demo.plc.block("FB_ShmRegion")
    size = {"udiPayloadSize": ctypes.sizeof(kind), "udiSizeOf": ctypes.sizeof(kind)}
    names = {"sTopic": topic, "sTypeName": kind._type_name_, "lwDigest": kind._digest_}
    assert region.method("Init", **names, **size, udiDepth=1, xWriter=writer)
    while not region.method("Cycle"):
        time.sleep(PERIOD)
    return region


DYING: dict[str, Play] = {
    "Python writer": python_writer_inside,
    "Python reader": python_reader_inside,
    "PLC writer": plc_writer_inside,
    "PLC reader": plc_reader_inside,
}
WRITING: dict[str, Play] = {
    "Python": python_writer,
    "Python, needs the lock": python_writer_in_need,
    "PLC": plc_writer,
    "PLC, standby": plc_writer,
}


class Process:
    """A child process that executes `play`."""

    def __init__(self, play: Play, demo: Any, topic: str, called: Callable[[], None]) -> None:
        self.pid = os.fork()
        if self.pid == 0:
            try:
                play(demo, topic, called)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(1)

    def kill(self) -> None:
        """Kill the process. A second call does nothing."""
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            self.pid = 0


def measure(demo: Any, topic: str, dies: str, writes: str, limit: float = 10.0) -> float:
    """Return the seconds from the kill until the writer and both readers have continued, or infinity after `limit`."""
    moves = memoryview(mmap.mmap(-1, mmap.PAGESIZE)).cast("Q")
    run: list[Process] = []
    victims: list[Process] = []

    def start(place: int, play: Play) -> None:
        def moved() -> None:
            moves[place] += 1

        run.append(Process(play, demo, topic, moved))

    def inside() -> None:
        moves[3] = 1
        signal.pause()

    try:
        start(0, python_reader)
        start(1, plc_reader)
        early = dies.endswith("reader")
        if early:
            start(2, WRITING[writes])
            _until(lambda: all(moves[:3]))
        holder = Process(DYING[dies], demo, topic, inside)
        victims.append(holder)
        if writes.endswith("standby") and not early:
            _until(lambda: _writer(topic) in (holder.pid, h.PLC))
            start(2, WRITING[writes])
        _until(lambda: bool(moves[3]))
        holder.kill()
        killed, before = time.monotonic(), list(moves[:3])
        if len(run) == 2:
            start(2, WRITING[writes])
        while any(now == then for now, then in zip(moves[:3], before, strict=True)):
            if time.monotonic() - killed > limit:
                return float("inf")
            time.sleep(PERIOD / 2)
        return time.monotonic() - killed
    finally:
        for process in (*run, *victims):
            process.kill()
        for file in Path("/dev/shm").glob(f"*{region_name(topic)}*"):
            file.unlink()


def _writer(topic: str) -> int:
    with suppress(RegionMissing):
        return read_header(region_name(topic)).writer
    return 0


def _until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end, "the play did not begin"
        time.sleep(PERIOD)


def main() -> None:
    """Measure all pairs and print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--tries", type=int, default=1, help="of which the best counts, where others use the machine")
    tries = parser.parse_args().tries
    longest = 0.0
    with tempfile.TemporaryDirectory(prefix="shmgen-takeover") as folder:
        demo = plc_demo.make(Path(folder))
        for dies in DYING:
            for writes in list(WRITING)[: 3 if dies.endswith("reader") else 4]:
                best = float("inf")
                for attempt in range(tries):
                    topic = f"/shmgen_takeover/t{os.getpid()}_{attempt}"
                    best = min(best, measure(demo, topic, dies, writes))
                    if best <= LIMIT:
                        break
                print(f"{dies + ' killed':<22} {writes + ' writes on':<34} {best:6.3f} s", flush=True)
                longest = max(longest, best)
    sys.exit(longest > LIMIT)


if __name__ == "__main__":
    main()
