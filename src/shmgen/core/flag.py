"""A flag that a signal handler may set."""

from __future__ import annotations

import time

_POLL_INTERVAL = 0.02


class Flag:
    """Like threading.Event, but set() takes no lock.

    A signal handler runs in the main thread. If the main thread is inside a method of a threading.Event at that moment,
    the Event's lock is held, and set() would wait for it forever.
    """

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        self._is_set = True

    def clear(self) -> None:
        self._is_set = False

    def is_set(self) -> bool:
        return self._is_set

    def wait(self, seconds: float) -> bool:
        """Wait at most `seconds` for the flag. Return True if the flag is set."""
        deadline = time.monotonic() + seconds
        while not self._is_set and (left := deadline - time.monotonic()) > 0:
            time.sleep(min(left, _POLL_INTERVAL))
        return self._is_set
