"""Reports the counters of all topics as a diagnostic_msgs/DiagnosticArray, with the levels of REP 107."""

from __future__ import annotations

import time
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

from shmgen.bridge.sides import Side
from shmgen.runtime import Time
from shmgen.runtime.messages.values import set_clock

OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""Constants of diagnostic_msgs/DiagnosticStatus."""


class Reporter:
    """Remembers what it said last, for a rate and a rejection are of the time between two reports."""

    def __init__(self, node: str) -> None:
        self._node = node
        self._before: dict[str, tuple[int, int, float]] = {}

    def fill(self, message: Any, sides: Iterable[Side], now: Time) -> None:
        """Into an empty DiagnosticArray of any ROS."""
        message.header.stamp = set_clock(message.header.stamp, now)
        message.status = [self.status(side) for side in sides]

    def status(self, side: Side) -> SimpleNamespace:
        """One DiagnosticStatus."""
        counters = side.counters
        wrong = counters.rejected + counters.truncated + counters.missed + counters.failed
        wrong += counters.refused + counters.lost
        now = time.monotonic()
        passed, faults, since = self._before.get(counters.topic, (0, 0, now))
        self._before[counters.topic] = (counters.passed, wrong, now)
        rate = (counters.passed - passed) / (now - since) if now > since else 0.0
        level, text = _judged(side, wrong - faults, rate)
        shown = {
            "way": side.about.way,
            "type": side.about.type,
            "region": side.about.region,
            "rate [Hz]": f"{rate:.1f}",
            "passed": counters.passed,
            "rejected": counters.rejected,
            "truncated": counters.truncated,
            "thinned": counters.thinned,
            "missed": counters.missed,
            "failed": counters.failed,
            "refused": counters.refused,
            "lost": counters.lost,
            "lock misses": side.end.lock_misses,
            "age [s]": "-" if counters.age is None else f"{counters.age:.3f}",
            "last complaint": counters.complaint or "-",
        }
        return SimpleNamespace(
            level=level,
            name=f"{self._node}: {counters.topic}",
            message=text,
            hardware_id="",
            values=[SimpleNamespace(key=key, value=str(value)) for key, value in shown.items()],
        )


def _judged(side: Side, faults: int, rate: float) -> tuple[int, str]:
    complaint = side.counters.complaint.partition("\n")[0]
    if side.end.now is None:
        return ERROR, side.end.why.partition("\n")[0]
    if silence := side.end.silence():
        return STALE, silence
    if side.counters.stranger:
        return WARN, side.counters.stranger
    if faults:
        return WARN, complaint or f"{faults} messages missed"
    return OK, f"{rate:.1f} Hz"
