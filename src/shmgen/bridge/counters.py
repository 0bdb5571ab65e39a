"""Counts what becomes of each message of a topic, and reports what is wrong with some of them in few lines."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

_QUIET = 5.0
"""Seconds between two complaints about one topic: a thousand messages a second may all be wrong."""


_NAMED = ("rejected", "truncated", "thinned", "missed", "failed", "refused", "lost")


@dataclass(slots=True)
class Counters:
    """Messages, or calls, since the bridge began.

    `passed` crossed, `truncated` of them cut; `rejected` did not fit; `thinned` were left out for `rate`; `missed`
    were overwritten in the region before they could be read, or came while there was none; `failed` are calls of a
    service without an answer; `refused` came from a peer that means something else by the type; `lost` were sent, and
    gone before ROS handed them over. `newest` is when the last one came, by the monotonic clock; `complaint` says what
    was wrong with the last that was, `stranger` why nothing of a peer that is there now may pass.
    """

    topic: str
    tell: Callable[[str], None]
    passed: int = 0
    rejected: int = 0
    truncated: int = 0
    thinned: int = 0
    missed: int = 0
    failed: int = 0
    refused: int = 0
    lost: int = 0
    newest: float | None = None
    complaint: str = ""
    stranger: str = ""
    _told: float = float("-inf")
    _held: int = 0

    @property
    def age(self) -> float | None:
        """Seconds since the newest message came."""
        return None if self.newest is None else time.monotonic() - self.newest

    def came(self) -> None:
        self.newest = time.monotonic()

    def reject(self, why: str, who: str = "") -> None:
        """One that does not fit, or that `who` would not take."""
        self.rejected += 1
        self.complain(f"rejected{who}: {why}")

    def refuse(self, why: str) -> None:
        """One of a peer that means something else by the type, who is told of once, elsewhere."""
        self.refused += 1
        self.complaint = why

    def meet(self, stranger: str) -> None:
        """A peer that means something else by the type; nothing, as soon as none of them is there."""
        self.stranger = stranger

    def lose(self, count: int) -> None:
        """So many that were sent and never came here."""
        self.lost += count
        self.complain(f"{count} lost on the way")

    def complain(self, text: str) -> None:
        """Tells it, unless the topic has been complained about within the last seconds."""
        self.complaint = text
        now = time.monotonic()
        if now - self._told < _QUIET:
            self._held += 1
            return
        more = f" (and {self._held} such complaints before)" if self._held else ""
        self._told, self._held = now, 0
        self.tell(f"{self.topic}: {text}{more}")

    def __str__(self) -> str:
        named = {name: getattr(self, name) for name in _NAMED}
        others = "".join(f", {number} {name}" for name, number in named.items() if number)
        return f"{self.passed} passed{others}"
