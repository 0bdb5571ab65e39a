"""Computes the rate, bandwidth and delay of a topic from the numbers and stamps of its samples."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple, TypeVar

from shmgen.live.classes import ClassRegistry
from shmgen.live.regions import sound
from shmgen.runtime import Header, Message, Sample
from shmgen.runtime.region.header import steps
from shmgen.tools.messages import stream
from shmgen.tools.messages.paths import Getter, getter

R = TypeVar("R")

_PERIOD = 1.0
"""Seconds between two reports."""
_WRITER = "the writer's stamp"


class Seen(NamedTuple):
    """A received sample: its number, the time at which it was written, and its age on arrival. Times are in seconds.

    `at` is the writer's stamp, or the time of arrival if the writer has no clock. `age` is None if there is no stamp.
    """

    number: int
    at: float
    age: float | None


class Window(NamedTuple):
    """The newest samples of a region, `seen`, from which a report is computed.

    `missed` counts samples that were overwritten before this process read them. `by` is the name of the stamp from
    which the ages of the samples were computed, such as `header.stamp`.
    """

    topic: str
    seen: Sequence[Seen]
    missed: int
    header: Header
    by: str


@dataclass(frozen=True, slots=True)
class Rate:
    """The rate of a topic: samples a second, and the seconds between two samples, over the last `window` samples.

    `missed` counts samples that were overwritten before this process read them. `rate` includes missed samples.
    """

    rate: float
    shortest: float
    longest: float
    deviation: float
    window: int
    missed: int

    def __str__(self) -> str:
        return f"average rate: {self.rate:.3f}\n{_spread(self)} missed: {self.missed}"


@dataclass(frozen=True, slots=True)
class Bandwidth:
    """The bandwidth of a topic: bytes a second, and bytes of one sample. All samples have the same size."""

    rate: float
    samples: float
    size: int

    def __str__(self) -> str:
        return f"{_bytes(self.rate)}/s from {self.samples:.1f} samples/s of {_bytes(self.size)}"


@dataclass(frozen=True, slots=True)
class Delay:
    """The delay of a topic: seconds from the stamp of a sample to its arrival here, over the last `window` samples.

    `by` is the name of the stamp, such as `header.stamp`.
    """

    mean: float
    shortest: float
    longest: float
    deviation: float
    window: int
    by: str

    def __str__(self) -> str:
        return f"average delay: {self.mean:.6f} by {self.by}\n{_spread(self)}"


def reports(
    make: Callable[[Window], R | None],
    topic: str,
    registry: ClassRegistry | None,
    window: int,
    timeout: float | None,
    tell: stream.Tell,
) -> Generator[R, None, None]:
    """Yield a report about a topic after each second with new samples, until an error occurs.

    `make` is the function rate, bandwidth or delay, which computes the report from the last `window` samples. Samples
    are polled each millisecond, which limits the precision of arrival times. Only delays need `registry`. Raises the
    errors of stream.messages(), and ValueError if a delay has no stamp.
    """
    with closing(stream.regions(topic, registry, timeout, tell)) as followed_regions:
        for view, reader in followed_regions:
            header, (by, stamp) = sound(view), _stamp(reader.message_type)
            reader.samples()  # skip existing samples: their arrival time is unknown
            seen: deque[Seen] = deque(maxlen=window)
            due, fresh = time.monotonic() + _PERIOD, False
            for samples in stream.batches(topic, view, reader, timeout):
                now = time.time()
                for sample in samples:
                    written = stamp(sample)
                    seen.append(Seen(sample.number, sample.stamp / 1e9 or now, now - written if written else None))
                    fresh = True
                if (since := time.monotonic()) >= due:
                    due += _PERIOD * (1 + (since - due) // _PERIOD)
                    if fresh and (report := make(Window(topic, seen, reader.missed, header, by))):
                        yield report
                    fresh = False


def rate(window: Window) -> Rate | None:
    """Compute the rate, or return None if there are not yet two samples with different times."""
    seen, slots = window.seen, window.header.slots
    first, last = seen[0], seen[-1]
    if last.at <= first.at:
        return None
    between = [b.at - a.at for a, b in pairwise(seen) if steps(a.number, b.number, slots) == 1] or [0.0]
    _, shortest, longest, deviation = _moments(between)
    average = steps(first.number, last.number, slots) / (last.at - first.at)
    return Rate(average, shortest, longest, deviation, len(seen), window.missed)


def bandwidth(window: Window) -> Bandwidth | None:
    """Compute the bandwidth, or return None if there are not yet two samples with different times."""
    size, report = window.header.payload_size, rate(window)
    return Bandwidth(report.rate * size, report.rate, size) if report else None


def delay(window: Window) -> Delay | None:
    """Compute the delay from `header.stamp` or `stamp`, else from the writer's stamp.

    Return None if the message's stamp was never set. Raises ValueError if there is no stamp.
    """
    ages = [one.age for one in window.seen if one.age is not None]
    if not ages and window.by == _WRITER:
        raise ValueError(f"{window.topic}: its messages have no time stamp, and its writer stores no time")
    return Delay(*_moments(ages), len(ages), window.by) if ages else None


def _stamp(kind: type[Message]) -> tuple[str, Callable[[Sample[Message]], float | None]]:
    for path in ("header.stamp", "stamp"):
        with suppress(ValueError):
            getter(kind, f"{path}.nanosec")
            return path, partial(_read_stamp, getter(kind, path))
    return _WRITER, lambda sample: sample.stamp / 1e9


def _read_stamp(get: Getter, sample: Sample[Message]) -> float | None:
    return number(get(sample.message))


def number(value: object) -> float | None:
    """Return a number, a bool, or a time in seconds as a float; return None for other types."""
    if isinstance(value, (bool, int, float)):
        return float(value)
    if hasattr(value, "sec") and hasattr(value, "nanosec"):
        return float(value.sec + value.nanosec / 1e9)
    return None


def _moments(values: Collection[float]) -> tuple[float, float, float, float]:
    """Return mean, minimum, maximum and standard deviation."""
    mean = math.fsum(values) / len(values)
    return mean, min(values), max(values), math.sqrt(math.fsum((one - mean) ** 2 for one in values) / len(values))


def _spread(report: Rate | Delay) -> str:
    least, most = f"min: {report.shortest:.6f}s", f"max: {report.longest:.6f}s"
    return f"\t{least} {most} std dev: {report.deviation:.6f}s window: {report.window}"


def _bytes(number: float) -> str:
    """Return a size with a suitable unit, such as `12.30 kB`."""
    for unit in ("B", "kB", "MB"):
        if number < 1000:
            return f"{number:.0f} B" if unit == "B" else f"{number:.2f} {unit}"
        number /= 1000
    return f"{number:.2f} GB"
