"""Turns what comes on a topic into how many bytes a second that is, and into how old it is when it is there."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import asdict, dataclass

from shmgen.live.classes import ClassRegistry
from shmgen.live.passive_reader import Sample, tap
from shmgen.live.regions import sound
from shmgen.runtime import Message
from shmgen.tools.messages.paths import getter
from shmgen.tools.messages.stream import POLL, Tell, appeared
from shmgen.tools.watch import hz

_PERIOD = 1.0
"""Seconds from one report to the next."""


@dataclass(frozen=True, slots=True)
class Bandwidth:
    """Bytes a second, and bytes of one sample: all of a topic are alike, and so is the memory they take."""

    rate: float
    samples: float
    size: int

    def __str__(self) -> str:
        return f"{bytes_of(self.rate)}/s from {self.samples:.1f} samples/s of {bytes_of(self.size)}"

    def plain(self) -> dict[str, float]:
        return asdict(self)


def bytes_of(number: float) -> str:
    """`12.3 kB`."""
    for unit in ("B", "kB", "MB"):
        if number < 1000:
            return f"{number:.0f} B" if unit == "B" else f"{number:.2f} {unit}"
        number /= 1000
    return f"{number:.2f} GB"


def bandwidths(topic: str, window: int, timeout: float | None, tell: Tell) -> Generator[Bandwidth, None, None]:
    """A report each second in which something came. Raises as hz.rates()."""
    rates = hz.rates(topic, window, timeout, tell)
    try:
        for rate in rates:
            with appeared(topic, timeout, tell) as view:
                size = sound(view).payload_size
            yield Bandwidth(rate.rate * size, rate.rate, size)
    finally:
        rates.close()


@dataclass(frozen=True, slots=True)
class Delay:
    """Seconds from a sample's stamp to when it was seen here, over the newest `window`; `by` says whose stamp."""

    mean: float
    shortest: float
    longest: float
    deviation: float
    window: int
    by: str

    def __str__(self) -> str:
        return (
            f"average delay: {self.mean:.6f} by {self.by}\n"
            f"\tmin: {self.shortest:.6f}s max: {self.longest:.6f}s std dev: {self.deviation:.6f}s window: {self.window}"
        )

    def plain(self) -> dict[str, float | str]:
        return asdict(self)


def delays(
    topic: str, registry: ClassRegistry, window: int, timeout: float | None, tell: Tell
) -> Generator[Delay, None, None]:
    """A report each second in which something came, by `header.stamp` or `stamp`, else by the writer's stamp.

    Seen each millisecond, so none is known better. Raises TimeoutError, PermissionDenied, RegionUnusable, Rejected and
    LayoutMismatch; ValueError where neither has a stamp.
    """
    while True:
        with appeared(topic, timeout, tell) as view:
            header = sound(view)
            kind = registry.message(header.type_name, header.digest)
            by, stamp = _stamp(kind)
            looking = tap(view, kind, whole=True)
            looking.take()  # what is there was not seen coming
            seen: deque[float] = deque(maxlen=window)
            heard = time.monotonic()
            due, fresh = heard + _PERIOD, False
            try:
                while not view.removed:
                    now = time.time()
                    for sample in looking.take():
                        heard, at = time.monotonic(), stamp(sample)
                        if at:
                            seen.append(now - at)
                            fresh = True
                        elif by == _WRITER:
                            raise ValueError(f"{topic}: its type has no stamp, and its writer has no clock")
                    if (since := time.monotonic()) >= due:
                        due += _PERIOD * (1 + (since - due) // _PERIOD)
                        if fresh:
                            yield _delay(seen, by)
                        fresh = False
                    if timeout is not None and since - heard > timeout:
                        raise TimeoutError(f"{topic}: no sample within {timeout:g} s; see `shmgen doctor {topic}`")
                    time.sleep(POLL)
            finally:
                looking.close()
        tell(f"{topic}: the region was removed; waiting for a new one")


_WRITER = "the writer's stamp"


def _stamp(kind: type[Message]) -> tuple[str, Callable[[Sample], float]]:
    for path in ("header.stamp", "stamp"):
        try:
            getter(kind, f"{path}.nanosec")
        except ValueError:
            continue
        return path, _of_message(kind, path)
    return _WRITER, lambda sample: sample.stamp / 1e9


def _of_message(kind: type[Message], path: str) -> Callable[[Sample], float]:
    get = getter(kind, path)

    def stamp(sample: Sample) -> float:
        clock = get(kind.from_buffer_copy(sample.payload))
        return float(clock.sec + clock.nanosec / 1e9)

    return stamp


def _delay(seen: deque[float], by: str) -> Delay:
    mean = math.fsum(seen) / len(seen)
    deviation = math.sqrt(math.fsum((one - mean) ** 2 for one in seen) / len(seen))
    return Delay(mean, min(seen), max(seen), deviation, len(seen), by)
