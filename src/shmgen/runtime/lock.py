"""Turns the region's semaphore into a lock that nobody waits for longer than the time limit."""

from __future__ import annotations

import os

from shmgen.runtime import header as h
from shmgen.runtime.region import Region


class Lock:
    """What is done when a try of the semaphore failed; publisher and subscriber make the try themselves.

    `keeps_order`: loads and stores of this machine keep their order (x86-64), so the slots alone carry
    integrity and one may go on without the lock. `misses` counts how often that, or giving up, happened.
    """

    __slots__ = ("_region", "_stuck_at", "keeps_order", "misses", "timeout")

    def __init__(self, region: Region, timeout: float) -> None:
        if not 0 <= timeout <= 60:
            raise ValueError(f"lock_timeout is {timeout}; it goes from 0 to 60 seconds")
        self._region = region
        self._stuck_at: int | None = None
        self.keeps_order = os.uname().machine in ("x86_64", "AMD64")
        self.misses = 0
        self.timeout = timeout

    def wait(self) -> bool:
        """Waits for the lock until the time limit; True = inside.

        Whoever gets in counts `lock_count` up. While it stands where it stood at the last time-out the lock
        is taken to be stuck, and waiting again would cost the limit each time for nothing.
        """
        count = self._region.words[h.LOCK_COUNT]
        if count != self._stuck_at and self._region.semaphore.acquire(True, self.timeout):
            return True
        self._stuck_at = count
        self.misses += 1
        return False
