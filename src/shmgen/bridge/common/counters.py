"""Counts the messages of a topic by outcome, and logs faults with a rate limit."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from shmgen.bridge.backend import NoAnswer
from shmgen.runtime import ShmError

_LOG_INTERVAL = 5.0
"""The minimum interval in seconds between two log lines for one topic, because 1000 messages per second may fail."""

SHOWN = ("rejected", "truncated", "rate_limited", "missed", "failed", "refused", "lost")
"""The counters that are shown after `passed`, in this order."""


@dataclass(slots=True)
class Counters:
    """The numbers of messages, calls or goals of a topic, service or action since the bridge started.

    The class implements ErrorSink of backend.py.

    * `passed`: delivered, including the `truncated` messages.
    * `truncated`: delivered, but shortened to fit the region.
    * `rejected`: invalid, or too long for the region.
    * `rate_limited`: dropped because of the key `rate`.
    * `missed`: overwritten in the region before the bridge read them, or arrived while the region was not open.
    * `failed`: calls without an answer, and goals that were rejected or aborted.
    * `refused`: from an incompatible peer.
    * `lost`: sent, but never delivered by ROS.
    """

    topic: str
    write_log: Callable[[str], None]
    passed: int = 0
    rejected: int = 0
    truncated: int = 0
    rate_limited: int = 0
    missed: int = 0
    failed: int = 0
    refused: int = 0
    lost: int = 0
    newest: float | None = None
    """The time of the last message by the monotonic clock, or None if no message has arrived."""
    complaint: str = ""
    """The text of the last fault, or `""` if there was no fault."""
    incompatible_peer: str = ""
    """The reason why a connected peer is incompatible, or `""` if all peers are compatible."""
    qos_problem: str = ""
    """The reason why a connected peer has incompatible QoS, or `""` if all peers match."""
    _last_logged_at: float = float("-inf")
    _suppressed_count: int = 0

    @property
    def age(self) -> float | None:
        """The age of the newest message in seconds, or None if no message has arrived."""
        return None if self.newest is None else time.monotonic() - self.newest

    @property
    def faults(self) -> int:
        """The number of faults: the sum of all counters except `passed` and `rate_limited`."""
        return sum(getattr(self, name) for name in SHOWN if name != "rate_limited")

    def mark_received(self) -> None:
        """Store the current time as the time of the newest message."""
        self.newest = time.monotonic()

    def reject(self, why: str, who: str = "") -> None:
        """Count and log a message that is invalid or too long. `who` is `" by ROS"` if ROS rejected the message."""
        self.rejected += 1
        self.log_rate_limited(f"rejected{who}: {why}")

    def refuse(self, why: str) -> None:
        """Count a message of an incompatible peer. Do not log it: the backend logs each such peer once."""
        self.refused += 1
        self.complaint = why

    def fail(self, text: str) -> None:
        """Count and log a failed call or goal."""
        self.failed += 1
        self.log_rate_limited(text)

    def set_incompatible_peer(self, reason: str) -> None:
        """Set the reason why a connected peer is incompatible, or `""` if no incompatible peer is connected."""
        self.incompatible_peer = reason

    def report_qos(self, problem: str) -> None:
        """Store `problem`, the reason why a peer's QoS does not match, or `""` if all match. Log a new reason once."""
        if problem and problem != self.qos_problem:
            self.log(problem)
        self.qos_problem = problem

    def lose(self, count: int) -> None:
        """Count and log `count` messages that a peer sent and that never arrived."""
        self.lost += count
        self.log_rate_limited(f"{count} lost in transit")

    def log(self, text: str) -> None:
        """Log `text` with the name of the topic, service or action."""
        self.write_log(f"{self.topic}: {text}")

    def log_rate_limited(self, text: str) -> None:
        """Log a fault, at most once in 5 s. A logged line contains the number of lines suppressed before it."""
        self.complaint = text
        now = time.monotonic()
        if now - self._last_logged_at < _LOG_INTERVAL:
            self._suppressed_count += 1
            return
        more = f" (and {self._suppressed_count} similar faults before)" if self._suppressed_count else ""
        self._last_logged_at, self._suppressed_count = now, 0
        self.log(f"{text}{more}")

    def __str__(self) -> str:
        numbers = {name.replace("_", " "): getattr(self, name) for name in SHOWN}
        return f"{self.passed} passed" + "".join(f", {number} {name}" for name, number in numbers.items() if number)


def describe(error: Exception) -> str:
    """Return the text of an error, with the name of its class if shmgen does not expect errors of that class."""
    expected = isinstance(error, (ShmError, OSError, NoAnswer))
    return str(error) if expected else f"{type(error).__name__}: {error}"
