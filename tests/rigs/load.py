"""Runs 64 topics at 1 kHz, all written by one process and all read by another, and prints misses, CPU time and memory.

    python -m tests.rigs.load --seconds 60

The exit code is 1 if a process has grown since the first tenth of the time, or if a sample is neither read nor counted
as missed.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from shmgen.runtime import region_name

from ..runtime.messages import PosePublisher, PoseSubscriber, pose
from ..support.region_of import region_of

TOPICS = 64
DEPTH = 16
PERIOD = 0.001
GROWTH = 1024
"""The largest growth of a process in KiB after the first tenth of the time: one arena of Python's allocator.

A leak of 16 bytes per sample is 1,500 KiB in three seconds, even if the machine is so busy that half are missed.
"""


def main() -> None:
    """Run the load and print a line for the writer and one for the reader."""
    parser = argparse.ArgumentParser(description="64 topics at 1 kHz.")
    parser.add_argument("--seconds", type=float, default=60)
    seconds = parser.parse_args().seconds
    names = [f"/shmgen_load/t{os.getpid()}/n{number}" for number in range(TOPICS)]
    try:
        readers = [PoseSubscriber(name, depth=DEPTH) for name in names]
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                code = write(names, seconds)
            finally:
                sys.stdout.flush()
                os._exit(code)
        result = read(readers, pid, seconds)
    finally:
        for name in names:
            for file in Path("/dev/shm").glob(f"*{region_name(name)}*"):
                file.unlink()
    sys.exit(result)


def write(names: list[str], seconds: float) -> int:
    writers = [PosePublisher(name, depth=DEPTH) for name in names]
    message = pose(1.0)
    late = [0]

    def cycle() -> None:
        for writer in writers:
            writer.publish(message)

    grown = _run_paced(cycle, seconds, late)
    print(f"writer: {writers[0].sequence} cycles of {TOPICS} samples, {late[0]} late by more than 1 ms, {grown.text}")
    return int(grown.kib > GROWTH)


def read(readers: list[Any], pid: int, seconds: float) -> int:
    count = [0] * TOPICS

    def cycle() -> None:
        for place, reader in enumerate(readers):
            count[place] += len(reader.read_all())

    grown = _run_paced(cycle, seconds, [0])
    _, status = os.waitpid(pid, 0)
    cycle()
    missed = sum(reader.missed for reader in readers)
    written = sum(region_of(reader).newest() for reader in readers)
    lock_misses = sum(reader.lock_misses for reader in readers)
    print(f"reader: {sum(count)} read, {missed} missed of {written}, {lock_misses} locks not free, {grown.text}")
    return int(os.waitstatus_to_exitcode(status) or grown.kib > GROWTH or sum(count) + missed != written)


def _run_paced(cycle: Callable[[], None], seconds: float, late: list[int]) -> SimpleNamespace:
    """Call `cycle` each millisecond. Return the growth in KiB since the first tenth of the time, and a report."""
    start, busy = time.monotonic(), _busy()
    before: int | None = None
    for due in _times(start, seconds):
        left = due - time.monotonic()
        if left > 0:
            time.sleep(left)
        elif left < -PERIOD:
            late[0] += 1
        cycle()
        if before is None and due - start > seconds / 10:
            before = _resident()
    now = _resident()
    cpu = (_busy() - busy) / (time.monotonic() - start)
    text = f"{cpu:.0%} of a core, {now} KiB resident, {now - (before or now):+} KiB since the first tenth"
    return SimpleNamespace(kib=now - (before or now), text=text)


def _times(start: float, seconds: float) -> Iterator[float]:
    return (start + number * PERIOD for number in range(round(seconds / PERIOD)))


def _busy() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() // 1024


if __name__ == "__main__":
    main()
