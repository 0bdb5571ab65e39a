"""Turns numbers over time into a drawing of characters: Braille, eight dots each, or plain ASCII."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Collection, Sequence

from shmgen.live.classes import ClassRegistry
from shmgen.live.passive_reader import tap
from shmgen.live.regions import sound
from shmgen.runtime import Message
from shmgen.tools.messages.paths import Getter, getter
from shmgen.tools.messages.stream import POLL, Tell, appeared

_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bits of a Braille character, row by row: Unicode, block 2800."""
_MOST = 20_000
"""Samples that are kept of a curve; of more the oldest go."""

Point = tuple[float, float]
"""Seconds and value."""


class Curves:
    """The numbers at some paths of a topic, over the last seconds."""

    def __init__(self, topic: str, paths: Sequence[str], seconds: float, registry: ClassRegistry, tell: Tell) -> None:
        """Waits for the region. Raises ValueError for a path that is no number, and as follow.samples()."""
        self.paths = tuple(paths)
        self.seconds = seconds
        self.missed = 0
        self._view = appeared(topic, None, tell)
        try:
            header = sound(self._view)
            self._kind = registry.message(header.type_name, header.digest)
            self._get = [_numeric(self._kind, path) for path in paths]
            self._tap = tap(self._view, self._kind)
        except BaseException:
            self._view.close()
            raise
        self.points: list[deque[Point]] = [deque(maxlen=_MOST) for _ in paths]

    def look(self) -> bool:
        """Takes what has come; False once the region is gone."""
        now = time.time()
        for sample in self._tap.take():
            message = self._kind.from_buffer_copy(sample.payload)
            at = sample.stamp / 1e9 if sample.stamp else now
            for points, get in zip(self.points, self._get, strict=True):
                value = number(get(message))
                if value is not None:
                    points.append((at, value))
        self.missed = self._tap.missed
        for points in self.points:
            while points and points[0][0] < now - self.seconds:
                points.popleft()
        return not self._view.removed

    def watch(self, seconds: float) -> bool:
        """look() again and again for so long."""
        ends = time.monotonic() + seconds
        there = self.look()
        while there and time.monotonic() < ends:
            time.sleep(POLL)
            there = self.look()
        return there

    def close(self) -> None:
        self._tap.close()
        self._view.close()


def _numeric(kind: type[Message], path: str) -> Getter:
    get = getter(kind, path)
    if number(get(kind())) is None and "[" not in path:
        raise ValueError(f"{path} is not a number; `shmgen echo --field {path}` prints it")
    return get


def number(value: object) -> float | None:
    """What can be plotted: a number, a bool, a time in seconds."""
    if isinstance(value, (bool, int, float)):
        return float(value)
    if hasattr(value, "sec") and hasattr(value, "nanosec"):
        return float(value.sec + value.nanosec / 1e9)
    return None


def drawing(
    names: Sequence[str], curves: Sequence[Collection[Point]], width: int, height: int, *, plain: bool = False
) -> list[str]:
    """So many lines of so many characters at most: a heading, the curves, and what the time axis covers.

    `plain`: ASCII alone, for terminals that know no other, a sign for each curve.
    """
    finite = [[point for point in curve if math.isfinite(point[1])] for curve in curves]
    newest = [
        f"{name} = {points[-1][1]:g}" if points else f"{name}: nothing yet"
        for name, points in zip(names, finite, strict=True)
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
