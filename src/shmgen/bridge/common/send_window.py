"""Waits for slow subscribers of large messages, so that every lost message is counted.

The queue of a topic holds few large messages. If the queue is full, DDS overwrites the oldest message, even if a
subscriber still waits for that message.
"""

from __future__ import annotations

import time
from collections.abc import Callable

_TIMEOUT = 4.0
"""Seconds to wait for a slow subscriber. Fast DDS resends a lost message within 3 s."""
_POLL_INTERVAL = 0.1
"""Seconds between two checks for acknowledgements."""


class SendWindow:
    """Delays large messages until slow subscribers have received enough of the earlier messages.

    Call `wait` before each send. While the queue may be full, `wait` blocks, and unsent samples stay in their region.
    After a timeout, `wait` returns 1 for each message that may be lost, until all messages are acknowledged.
    `acknowledged(seconds)` is the function of RosPublisher, and `queue` the length of the queue in messages.
    """

    def __init__(self, acknowledged: Callable[[float], bool], queue: int, is_over: Callable[[], bool]) -> None:
        self._acknowledged = acknowledged
        self._queue = queue
        self._is_over = is_over
        self._outstanding = 0
        self._is_late = False

    def wait(self) -> int:
        """Wait for a free place in the queue. Return 1 if the next send may overwrite an unreceived message, else 0."""
        if self._outstanding >= self._queue // 2:
            self._poll(0.0)  # cheap, and usually makes the wait below unnecessary
        deadline = time.monotonic() + (0 if self._is_late else _TIMEOUT)
        while self._outstanding >= self._queue and time.monotonic() < deadline and not self._is_over():
            self._poll(_POLL_INTERVAL)
        self._is_late = self._outstanding >= self._queue
        self._outstanding += 1
        return int(self._is_late)

    def _poll(self, seconds: float) -> None:
        if self._acknowledged(seconds):
            self._outstanding = 0
