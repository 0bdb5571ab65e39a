"""The rate, the bandwidth and the delay of a topic, from the numbers and stamps of its samples."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple, TypeVar

from shmgen.live.classes import ClassRegistry
from shmgen.live.regions import sound
from shmgen.runtime import Header, Message, Sample
from shmgen.runtime.region.header import steps
from shmgen.tools.messages import stream
from shmgen.tools.messages.paths import Getter, getter
from shmgen.tools.watch.plot import number

R = TypeVar("R")

_PERIOD = 1.0
"""Seconds from one report to the next."""
_WRITER = "the writer's stamp"


class Seen(NamedTuple):
    """A sample's number, when it was written, or came if its writer has no clock, and how old it was when it came.

    In seconds; `age` is None where there is no stamp.
    """

    number: int
    at: float
    age: float | None


class Window(NamedTuple):
    """The newest samples of a region, how many were overwritten unseen, and by whose stamp their ages are."""

    topic: str
    seen: Sequence[Seen]
    missed: int
    header: Header
    by: str


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
        return f"average rate: {self.rate:.3f}\n{_spread(self)} missed: {self.missed}"

    def plain(self) -> dict[str, float]:
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Bandwidth:
    """Bytes a second, and bytes of one sample: all of a topic are alike, and so is the memory they take."""

    rate: float
    samples: float
    size: int

    def __str__(self) -> str:
        return f"{_bytes(self.rate)}/s from {self.samples:.1f} samples/s of {_bytes(self.size)}"

    def plain(self) -> dict[str, float]:
        return asdict(self)


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
        return f"average delay: {self.mean:.6f} by {self.by}\n{_spread(self)}"

    def plain(self) -> dict[str, float | str]:
        return asdict(self)


def reports(
    make: Callable[[Window], R | None],
    topic: str,
    registry: ClassRegistry | None,
    window: int,
    timeout: float | None,
    tell: stream.Tell,
) -> Generator[R, None, None]:
    """What `make`, one of the three below, says each second in which something came; ends only by an error, or closed.

    Samples are seen each millisecond, so no arrival is known better. `registry` is for delays. Raises as
    stream.messages(), and ValueError where a delay has no stamp to go by.
    """
    with closing(stream.regions(topic, registry, timeout, tell)) as found:
        for view, reader in found:
            header, (by, stamp) = sound(view), _stamp(reader.message_type)
            reader.samples()  # what is there was not seen coming
            seen: deque[Seen] = deque(maxlen=window)
            due, fresh = time.monotonic() + _PERIOD, False
            for taken in stream.looks(topic, view, reader, timeout):
                now = time.time()
                for sample in taken:
                    written = stamp(sample)
                    seen.append(Seen(sample.number, sample.stamp / 1e9 or now, now - written if written else None))
                    fresh = True
                if (since := time.monotonic()) >= due:
                    due += _PERIOD * (1 + (since - due) // _PERIOD)
                    if fresh and (report := make(Window(topic, seen, reader.missed, header, by))):
                        yield report
                    fresh = False


def rate(window: Window) -> Rate | None:
    """None as long as there are not two samples some time apart."""
    seen, slots = window.seen, window.header.slots
    first, last = seen[0], seen[-1]
    if last.at <= first.at:
        return None
    between = [b.at - a.at for a, b in pairwise(seen) if steps(a.number, b.number, slots) == 1] or [0.0]
    _, shortest, longest, deviation = _moments(between)
    average = steps(first.number, last.number, slots) / (last.at - first.at)
    return Rate(average, shortest, longest, deviation, len(seen), window.missed)


def bandwidth(window: Window) -> Bandwidth | None:
    """None as rate()."""
    size, found = window.header.payload_size, rate(window)
    return Bandwidth(found.rate * size, found.rate, size) if found else None


def delay(window: Window) -> Delay | None:
    """By `header.stamp` or `stamp`, else by the writer's stamp; None where the former was never set."""
    ages = [one.age for one in window.seen if one.age is not None]
    if not ages and window.by == _WRITER:
        raise ValueError(f"{window.topic}: its type has no stamp, and its writer has no clock")
    return Delay(*_moments(ages), len(ages), window.by) if ages else None


def _stamp(kind: type[Message]) -> tuple[str, Callable[[Sample[Message]], float | None]]:
    for path in ("header.stamp", "stamp"):
        with suppress(ValueError):
            getter(kind, f"{path}.nanosec")
            return path, partial(_stamped, getter(kind, path))
    return _WRITER, lambda sample: sample.stamp / 1e9


def _stamped(get: Getter, sample: Sample[Message]) -> float | None:
    return number(get(sample.message))


def _moments(values: Collection[float]) -> tuple[float, float, float, float]:
    """Mean, least, most, standard deviation."""
    mean = math.fsum(values) / len(values)
    return mean, min(values), max(values), math.sqrt(math.fsum((one - mean) ** 2 for one in values) / len(values))


def _spread(report: Rate | Delay) -> str:
    least, most = f"min: {report.shortest:.6f}s", f"max: {report.longest:.6f}s"
    return f"\t{least} {most} std dev: {report.deviation:.6f}s window: {report.window}"


def _bytes(number: float) -> str:
    """`12.3 kB`."""
    for unit in ("B", "kB", "MB"):
        if number < 1000:
            return f"{number:.0f} B" if unit == "B" else f"{number:.2f} {unit}"
        number /= 1000
    return f"{number:.2f} GB"
