"""Publishes large messages so that none is lost uncounted: the queue of a topic holds few of them.

DDS keeps the newest of a queue, and overwrites what a subscriber still waits for without a word.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration

_PATIENCE = 4.0
"""Seconds; what was lost on the way is sent again by Fast DDS after 3 at the latest."""
_LOOK = Duration(seconds=0.1)
_AT_ONCE = Duration()


class Outlet:
    """A publisher of rclpy that waits as soon as its queue may be full; the PLC's samples wait in their region then.

    A subscriber that has used up the patience is not waited for again until it has caught up: what it may lose is
    counted.
    """

    def __init__(self, publisher: Any, queue: int, is_over: Callable[[], bool]) -> None:
        self._publisher = publisher
        self._queue = queue
        self._is_over = is_over
        self._waiting = 0
        self._is_late = False

    def publish(self, data: bytes) -> int:
        """How many that a subscriber may still have waited for were overwritten by this one."""
        if self._waiting >= self._queue // 2:
            self._look(_AT_ONCE)  # costs next to nothing, and mostly saves the wait
        deadline = time.monotonic() + (0 if self._is_late else _PATIENCE)
        while self._waiting >= self._queue and time.monotonic() < deadline and not self._is_over():
            self._look(_LOOK)
        self._is_late = self._waiting >= self._queue
        self._publisher.publish(data)
        self._waiting += 1
        return int(self._is_late)

    def _look(self, patience: Duration) -> None:
        if self._publisher.wait_for_all_acked(patience):
            self._waiting = 0
