"""Turns the numbers and stamps of a topic's samples into their rate."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Generator
from dataclasses import asdict, dataclass
from itertools import pairwise

from shmgen.live.regions import View, sound
from shmgen.runtime.region.header import steps
from shmgen.tools.messages.stream import POLL, Tell, appeared

WINDOW = 10_000
"""Samples looked at, as `ros2 topic hz` has it."""
_PERIOD = 1.0
"""Seconds from one report to the next."""
_AT_ONCE = 64
"""Of a burst so many samples are looked at; the others still count for the rate."""


@dataclass(frozen=True, slots=True)
class Rate:
    """Samples a second, and the seconds between samples that followed each other, over the newest `window` seen.

    `missed` is how many were overwritten before they could be looked at here; they count in `rate`.
    """

    rate: float
    shortest: float
    longest: float
    deviation: float
    window: int
    missed: int

    def __str__(self) -> str:
        return (
            f"average rate: {self.rate:.3f}\n"
            f"\tmin: {self.shortest:.6f}s max: {self.longest:.6f}s std dev: {self.deviation:.6f}s "
            f"window: {self.window} missed: {self.missed}"
        )

    def plain(self) -> dict[str, float]:
        return asdict(self)


def rates(topic: str, window: int, timeout: float | None, tell: Tell) -> Generator[Rate, None, None]:
    """A report each second in which something came; ends only by an error, or when it is closed.

    Times are the writer's stamps; of a writer without a clock, the time of arrival to the millisecond. Raises
    TimeoutError after `timeout` seconds without a sample, PermissionDenied and RegionUnusable.
    """
    while True:
        with appeared(topic, timeout, tell) as view:
            yield from _of_region(topic, view, window, timeout)
        tell(f"{topic}: the region was removed; waiting for a new one")


def _of_region(topic: str, view: View, window: int, timeout: float | None) -> Generator[Rate, None, None]:
    seen: deque[tuple[int, float]] = deque(maxlen=window)
    last = view.header().completed
    missed = fresh = 0
    heard = time.monotonic()
    due = heard + _PERIOD
    while not view.removed:
        slots = sound(view).slots
        found, number = _since(view, last)
        if number != last:
            missed += steps(last, number, slots) - len(found)
            heard = time.monotonic()
        last = number
        seen.extend(found)
        fresh += len(found)
        if (now := time.monotonic()) >= due:
            due += _PERIOD * (1 + (now - due) // _PERIOD)
            if fresh and (rate := _rate(seen, missed, slots)):
                yield rate
            fresh = 0
        if timeout is not None and now - heard > timeout:
            raise TimeoutError(f"{topic}: no sample within {timeout:g} s; see `shmgen doctor {topic}`")
        time.sleep(POLL)


def _since(view: View, last: int) -> tuple[list[tuple[int, float]], int]:
    """(number, seconds) of each sample after `last` that is still there, and the number of the newest."""
    header = sound(view)
    arrived = time.time()
    newest = header.completed
    new = min(steps(last, newest, header.slots), header.slots, _AT_ONCE)
    found = []
    for back in range(new - 1, -1, -1):
        number = newest - back
        stamp = view.stamp(number, header) if number > 0 else None
        if stamp is not None:
            found.append((number, stamp / 1e9 if stamp else arrived))
    return found, newest


def _rate(seen: deque[tuple[int, float]], missed: int, slots: int) -> Rate | None:
    """None as long as there are not two samples some time apart."""
    (first, begun), (last, ended) = seen[0], seen[-1]
    if ended <= begun:
        return None
    between = [b - a for (m, a), (n, b) in pairwise(seen) if steps(m, n, slots) == 1] or [0.0]
    mean = math.fsum(between) / len(between)
    deviation = math.sqrt(math.fsum((item - mean) ** 2 for item in between) / len(between))
    rate = steps(first, last, slots) / (ended - begun)
    return Rate(rate, min(between), max(between), deviation, len(seen), missed)
