"""Reports the counters of all topics as a diagnostic_msgs/DiagnosticArray, with the levels of REP 107."""

from __future__ import annotations

import time
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

from shmgen.bridge.common.counters import SHOWN
from shmgen.bridge.endpoint import Side
from shmgen.runtime import Time
from shmgen.runtime.messages.times import set_clock

OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""The levels of diagnostic_msgs/DiagnosticStatus."""


class Reporter:
    """Creates the diagnostics of all topics, services and actions. Each report covers the time since the last one."""

    def __init__(self, node: str) -> None:
        self._node = node
        self._before: dict[str, tuple[int, int, float]] = {}

    def fill(self, message: Any, sides: Iterable[Side], now: Time) -> None:
        """Fill `message`, an empty DiagnosticArray, with a status for each topic, service and action."""
        message.header.stamp = set_clock(message.header.stamp, now)
        message.status = [self.status(side) for side in sides]

    def status(self, side: Side) -> SimpleNamespace:
        """Return the DiagnosticStatus of one topic, service or action, with the changes since the last report."""
        counters = side.counters
        now = time.monotonic()
        passed, faults, since = self._before.get(counters.topic, (0, 0, now))
        self._before[counters.topic] = (counters.passed, counters.faults, now)
        rate = (counters.passed - passed) / (now - since) if now > since else 0.0
        level, text = _level_and_text(side, counters.faults - faults, rate)
        values = {
            "way": side.about.direction,
            "type": side.about.type,
            "region": side.about.region,
            "rate [Hz]": f"{rate:.1f}",
            "passed": counters.passed,
            **{name.replace("_", " "): getattr(counters, name) for name in SHOWN},
            "lock misses": getattr(side.end.current, "lock_misses", 0),
            "age [s]": "-" if counters.age is None else f"{counters.age:.3f}",
            "last complaint": counters.complaint or "-",
        }
        return SimpleNamespace(
            level=level,
            name=f"{self._node}: {counters.topic}",
            message=text,
            hardware_id="",
            values=[SimpleNamespace(key=key, value=str(value)) for key, value in values.items()],
        )


def _level_and_text(side: Side, faults: int, rate: float) -> tuple[int, str]:
    counters = side.counters
    if side.end.current is None:
        return ERROR, _first_line(side.end.unavailable_reason)
    if silence := side.silence():
        return STALE, silence
    if peer_problem := counters.incompatible_peer or counters.qos_problem:
        return WARN, peer_problem
    if faults:
        return WARN, _first_line(counters.complaint) or f"{faults} messages missed"
    return OK, f"{rate:.1f} Hz"


def _first_line(text: str) -> str:
    return text.partition("\n")[0]
