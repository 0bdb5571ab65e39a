"""Draws numbers over time with characters: Braille, eight dots each, or plain ASCII."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Collection, Mapping, Sequence

from shmgen.live.classes import ClassRegistry
from shmgen.runtime import Message, Sample
from shmgen.tools.messages import stream
from shmgen.tools.messages.paths import Getter, getter

_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bits of a Braille character, row by row: Unicode, block 2800."""
_MOST = 20_000
"""Samples that are kept of a curve; of more the oldest go."""

Point = tuple[float, float]
"""Seconds and value."""


class Curves:
    """Numbers of a topic's messages over time; `points` by the path they are at."""

    def __init__(self) -> None:
        self.points: dict[str, deque[Point]] = {}
        self._getters: dict[str, Getter] = {}

    def add(self, path: str, message: Message) -> None:
        """Raises ValueError where `message` has no number there; an element of a sequence may still come."""
        get = getter(type(message), path)
        if number(get(message)) is None and "[" not in path:
            raise ValueError(f"{path} is not a number; `shmgen echo --field {path}` prints it")
        self.points[path], self._getters[path] = deque(maxlen=_MOST), get

    def drop(self, path: str) -> None:
        del self.points[path], self._getters[path]

    def clear(self) -> None:
        self.points.clear()
        self._getters.clear()

    def take(self, samples: Sequence[Sample[Message]]) -> None:
        now = time.time()
        for sample in samples if self._getters else ():
            message, at = sample.message, sample.stamp / 1e9 or now
            for path, get in self._getters.items():
                value = number(get(message))
                if value is not None:
                    self.points[path].append((at, value))


class Plot:
    """The numbers at some paths of a topic, over the last seconds."""

    def __init__(
        self, topic: str, paths: Sequence[str], seconds: float, registry: ClassRegistry, tell: stream.Tell
    ) -> None:
        """Waits for the region. Raises ValueError for a path that is no number, and as stream.messages()."""
        self._topic, self._seconds = topic, seconds
        self._curves = Curves()
        self.points = self._curves.points
        self._regions = stream.regions(topic, registry, None, tell)
        self._view, self._reader = next(self._regions)
        try:
            for path in paths:
                self._curves.add(path, self._reader.message_type())
        except BaseException:
            self.close()
            raise

    @property
    def missed(self) -> int:
        return self._reader.missed

    def watch(self, seconds: float) -> bool:
        """Takes what comes for so long; False once the region is gone."""
        ends = time.monotonic() + seconds
        for taken in stream.looks(self._topic, self._view, self._reader, None):
            self._curves.take(taken)
            if time.monotonic() >= ends:
                break
        for points in self.points.values():
            while points and points[0][0] < time.time() - self._seconds:
                points.popleft()
        return not self._view.removed

    def close(self) -> None:
        self._regions.close()


def number(value: object) -> float | None:
    """What can be plotted: a number, a bool, a time in seconds."""
    if isinstance(value, (bool, int, float)):
        return float(value)
    if hasattr(value, "sec") and hasattr(value, "nanosec"):
        return float(value.sec + value.nanosec / 1e9)
    return None


def drawing(curves: Mapping[str, Collection[Point]], width: int, height: int, *, plain: bool = False) -> list[str]:
    """So many lines of so many characters at most: a heading, the curves, and what the time axis covers.

    `plain`: ASCII alone, for terminals that know no other, a sign for each curve.
    """
    finite = [[point for point in curve if math.isfinite(point[1])] for curve in curves.values()]
    newest = [
        f"{name} = {points[-1][1]:g}" if points else f"{name}: nothing yet"
        for name, points in zip(curves, finite, strict=True)
    ]
    heading = "   ".join(newest)[:width]
    every = [point for points in finite for point in points]
    if not every:
        return [heading]
    times, values = [at for at, _ in every], [value for _, value in every]
    low, high, begun, ended = min(values), max(values), min(times), max(times)
    if low == high:
        low, high = low - 1, high + 1
    labels = [f"{high:.6g}", f"{low:.6g}"]
    margin = max(map(len, labels))
    columns, rows = max(4, width - margin - 2), max(2, height - 2)
    across, down = (1, 1) if plain else (2, 4)
    cells: dict[tuple[int, int], str | int] = {}
    for sign, points in zip("*+ox#@" * len(finite), finite, strict=False):
        for at, value in points:
            x = round((at - begun) / ((ended - begun) or 1) * (columns * across - 1))
            y = round((high - value) / (high - low) * (rows * down - 1))
            place = y // down, x // across
            if plain:
                cells[place] = sign
            else:
                cells[place] = int(cells.get(place, 0)) | _DOTS[y % down][x % across]
    lines = [heading]
    for row in range(rows):
        label = labels[0] if row == 0 else labels[1] if row == rows - 1 else ""
        drawn = (cells.get((row, column), " " if plain else 0) for column in range(columns))
        text = "".join(sign if isinstance(sign, str) else chr(0x2800 + sign) if sign else " " for sign in drawn)
        lines.append(f"{label:>{margin}} {'|' if plain else '┤'}{text}".rstrip())
    return [*lines, f"{'':>{margin}}  the last {ended - begun:.1f} s, {len(every):,} values"[:width]]
