"""Plots the newest values of some numbers over time, with pause and zoom."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from operator import itemgetter

from textual_plotext import PlotextPlot

from shmgen.core.escape import legible
from shmgen.view.source import Point

_SECONDS = 10.0
_LEAST, _MOST = 0.1, 600.0
"""Smallest and largest number of seconds across the plot."""


class Curves(PlotextPlot):
    """A plot of fields over time, with one curve for each path in `curves`.

    The time axis shows seconds before now, or before the pause.
    """

    def __init__(self, curves: Mapping[str, deque[Point]]) -> None:
        super().__init__()
        self._curves = curves
        self._seconds = _SECONDS
        self._paused_at: float | None = None
        self._shifted = 0.0

    def set_paused(self, is_paused: bool) -> None:
        self._paused_at = time.time() if is_paused else None
        self._shifted = 0.0

    def zoom(self, factor: float) -> None:
        self._seconds = min(_MOST, max(_LEAST, self._seconds * factor))
        self.draw()

    def shift(self, part: float) -> None:
        """Move the plot in time by `part` of its width, if the plot is paused."""
        if self._paused_at is not None:
            self._shifted += part * self._seconds
            self.draw()

    def draw(self) -> None:
        end = (self._paused_at or time.time()) + self._shifted
        plot = self.plt
        plot.clear_data()
        plot.clear_figure()
        plot.xlabel(f"seconds; {self._seconds:g} across" + (", paused" if self._paused_at else ""))
        drawn: list[float] = []
        for path, points in self._curves.items():
            seen = [point for point in points if end - self._seconds <= point[0] <= end and math.isfinite(point[1])]
            if seen:
                thin = _reduce_points(seen, 4 * max(10, self.size.width))
                plot.plot(
                    [at - end for at, _ in thin], [value for _, value in thin], label=legible(path), marker="braille"
                )
                drawn += [value for _, value in thin]
        if drawn:
            plot.xlim(-self._seconds, 0)
            if ticks := round_ticks(min(drawn), max(drawn)):
                plot.yticks(ticks, [f"{tick:.10g}" for tick in ticks])
        else:
            plot.title(
                "Press Enter on a number in the tree, or click it, to plot it"
                if not self._curves
                else "no samples in this time"
            )
        self.refresh()


def round_ticks(least: float, most: float) -> list[float]:
    """Return at most eight round numbers between `least` and `most`, or none if the range is empty or infinite.

    Without this function, plotext would choose the ticks, and might label one of them -0.00.
    """
    span = most - least
    if not 1e-300 < span < math.inf:
        return []
    power = 10.0 ** (math.floor(math.log10(span)) - 1)
    step = next(power * part for part in (1, 2, 5, 10, 20) if span / (power * part) <= 7)
    return [number * step for number in range(math.ceil(least / step), math.floor(most / step) + 1)]


def _reduce_points(points: list[Point], most: int) -> list[Point]:
    """Reduce the points to at most `most`. Keep the minimum and maximum of each interval, so that no peak is lost."""
    if len(points) <= most:
        return points
    size = 2 * len(points) / most
    thinned = []
    for number in range(most // 2):
        part = points[int(number * size) : int((number + 1) * size)]
        if part:
            thinned += sorted({min(part, key=itemgetter(1)), max(part, key=itemgetter(1))})
    return thinned
