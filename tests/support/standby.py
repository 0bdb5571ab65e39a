"""A PLC that takes a topic over or replaces a region while a bridge runs, and a watcher of heartbeats."""

from __future__ import annotations

import mmap
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from math import inf
from pathlib import Path

from shmgen.runtime import region_name
from shmgen.runtime.region import header as h
from shmgen.runtime.region.names import region_file


def file_of(topic: str) -> Path:
    return Path(region_file(region_name(topic)))


@contextmanager
def words_of(path: Path) -> Iterator[memoryview]:
    """Return the header and the slots of a region as 32-bit numbers."""
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as data, memoryview(data).cast("I") as words:
        yield words


@contextmanager
def a_plc_writes(topic: str) -> Iterator[None]:
    """Take a topic over and keep its heartbeat running. At the end, release the topic."""
    stop = threading.Event()
    with words_of(file_of(topic)) as words:

        def beat() -> None:
            while not stop.wait(0.005):
                words[h.WRITER] = h.PLC
                words[h.HEARTBEAT] = words[h.HEARTBEAT] + 1 & h.LAST

        thread = threading.Thread(target=beat)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()
            words[h.WRITER] = 0


def made_anew(topic: str, change: Callable[[memoryview], object]) -> None:
    """Replace a region by a changed copy in a new file, as a PLC would."""
    file = file_of(topic)
    new = file.with_name(f"{file.name}_new")
    new.write_bytes(file.read_bytes())
    os.chmod(new, file.stat().st_mode)
    with words_of(new) as words:
        change(words)
    new.rename(file)


class Onlooker:
    """Measure the longest time in seconds without a heartbeat of each topic, inside a `with` statement.

    Call `late` when a heartbeat is unchanged for `limit` seconds, and again after twice the time.
    """

    def __init__(self, topics: Iterable[str], limit: float = inf, late: Callable[[], object] = list) -> None:
        self.longest = dict.fromkeys(topics, 0.0)
        self._limit, self._late = limit, late
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Onlooker:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        seen = {topic: (-1, time.monotonic()) for topic in self.longest}
        looked = time.monotonic()
        while not self._stop.wait(0.005):
            now = time.monotonic()
            late, looked = now - looked - 0.005, now  # this thread had to wait itself
            for topic, (before, since) in seen.items():
                beat = self._beat(topic)
                seen[topic] = (beat, now) if beat not in (before, None) else (before, since + max(0.0, late))
                self.longest[topic] = max(self.longest[topic], now - seen[topic][1])
            if max(self.longest.values()) > self._limit:
                self._limit *= 2
                self._late()

    def _beat(self, topic: str) -> int | None:
        with suppress(OSError), file_of(topic).open("rb") as file:
            return int.from_bytes(os.pread(file.fileno(), 4, 4 * h.HEARTBEAT), "little")
        return None
