"""The lock of a region. Waiting for the lock is limited, and the lock of a dead process is taken over."""

from __future__ import annotations

import os
import time

from shmgen.core import abi
from shmgen.runtime.reference.memory_order import keeps_order
from shmgen.runtime.reference.region import Region
from shmgen.runtime.region import header as h
from shmgen.runtime.region.record_locks import lock_byte, unlock_byte

LOCK_TIMEOUT = abi.LOCK_MS / 1000
"""Seconds of the default lock timeout, and of the longest single wait."""
_DEAD_AFTER = abi.DEAD_MS / 1000
_STUCK_AFTER = abi.RECOVER_MS / 1000
"""Seconds until a held lock is recovered: `_DEAD_AFTER` if the holder is a dead process, otherwise `_STUCK_AFTER`."""
_PAUSE = 1e-4
"""Seconds between two tries. A holder that runs releases the lock within a few microseconds."""
_SURPLUS = 64
"""The largest number of surplus semaphore tokens that one call removes."""


class Lock:
    """The lock of a region, or a placeholder for a region without a lock.

    `keeps_order` is True if samples are safe without the lock: on x86, which keeps loads and stores in order, and in
    a region without a lock. Readers then detect an overwritten sample by the number in its slot.
    `misses` is the number of times that the lock was not free in time.
    """

    def __init__(self, region: Region, timeout: float) -> None:
        self.keeps_order = keeps_order() or not region.semaphore.is_there
        self.timeout = timeout
        self.misses = 0
        self._region = region
        # The present holder may be stuck. Its recovery time starts now and runs during the claim of a writer.
        self._seen: tuple[int, int] | None = self._stay() if region.semaphore.value == 0 else None
        self._since = time.monotonic()
        self._waited = False

    def acquire(self, left: float | None = None) -> bool:
        """Wait for the lock. Return True if this process now holds the lock, or False after the timeout.

        `left` is the remaining time in seconds of the caller's own timeout, or None. Wait at most this long:
        * On x86, where samples are safe without the lock: the lock timeout, or `left` if `left` is shorter. Do not wait
          at all if an earlier call has waited in vain for the present holder.
        * On other machines, which need the lock: `left`, or the lock timeout if `left` is None.

        If `lock_holder` and `lock_count` in the header do not change for the recovery time, the holder is considered
        dead or stuck. Then take the lock over from this holder.
        """
        self.release()  # still held if a second exception has interrupted the cleanup after a first
        if self._region.semaphore.acquire() or self._wait(left):
            words = self._region.words
            words[h.LOCK_COUNT] = words[h.LOCK_COUNT] + 1 & h.LAST
            words[h.LOCK_HOLDER] = self._region.pid
            return True
        return False

    def release(self) -> None:
        """Release the lock if this process holds it.

        The lock is a semaphore with one token, which the holder returns. If the semaphore already has a token, remove
        at most `_SURPLUS` tokens and return one. Surplus tokens exist if a holder considered dead has continued, if two
        processes have recovered the lock, or if an unrelated program has posted the semaphore.
        """
        semaphore = self._region.semaphore
        if not semaphore.held:
            return
        self._region.words[h.LOCK_HOLDER] = 0
        if not semaphore.post():
            for _ in range(_SURPLUS):
                if not semaphore.acquire():
                    break
            semaphore.post()
            semaphore.held.clear()
        elif semaphore.value > 1 and semaphore.acquire():
            semaphore.post()  # our post was surplus: we were stopped before it and considered dead
            semaphore.held.clear()

    def _wait(self, left: float | None) -> bool:
        if not self._region.semaphore.is_there:
            return False  # a region without a lock counts no misses
        limit = self.timeout if left is None else max(0.0, min(left, self.timeout) if self.keeps_order else left)
        end = time.monotonic() + limit
        while True:
            stay = self._stay()
            if stay != self._seen:
                self._seen, self._since, self._waited = stay, time.monotonic(), False
            if limit > 0 and not (self._waited and self.keeps_order):
                self._waited = True
                if self._try_for(limit if self.keeps_order else min(limit, LOCK_TIMEOUT)):
                    return True
            if self._overdue(stay) and self._recover(stay):
                return True
            limit = end - time.monotonic()
            if self.keeps_order or limit <= 0:
                self.misses += 1
                return False

    def _stay(self) -> tuple[int, int]:
        """Return `lock_holder` and `lock_count`, which identify one acquisition of the lock.

        A holder increments the count before it stores its id. Therefore an equal pair means the same acquisition.
        """
        return self._region.words[h.LOCK_HOLDER], self._region.words[h.LOCK_COUNT]

    def _try_for(self, seconds: float) -> bool:
        end = time.monotonic() + seconds
        while not self._region.semaphore.acquire():
            if time.monotonic() >= end:
                return False
            time.sleep(_PAUSE)
        return True

    def _overdue(self, stay: tuple[int, int]) -> bool:
        stood = time.monotonic() - self._since
        return stood >= _STUCK_AFTER or (stood >= _DEAD_AFTER and _is_dead(stay[0]))

    def _recover(self, stay: tuple[int, int]) -> bool:
        """Take over the lock from a dead holder. Return True if this process now holds the lock.

        `stay` is the result of _stay() for the dead holder. A record lock lets one process at a time take over. First
        wait for the semaphore once more, because the lock may be free by now. Do not free the lock before the takeover:
        a third process could acquire it, and would look like the dead holder until it has incremented `lock_count`.
        """
        file = self._region.file
        try:
            try:
                is_recovered = lock_byte(file, abi.REPAIR_LOCK) and self._take_place(stay)
            finally:
                unlock_byte(file, abi.REPAIR_LOCK)
        except BaseException:
            unlock_byte(file, abi.REPAIR_LOCK)  # again, because a signal handler may have interrupted the first unlock
            raise
        return is_recovered

    def _take_place(self, stay: tuple[int, int]) -> bool:
        region, words = self._region, self._region.words
        if self._try_for(min(self.timeout, LOCK_TIMEOUT)):
            return True
        if self._stay() != stay:
            return False
        region.semaphore.held.append(None)
        words[h.LOCK_COUNT] = stay[1] + 1 & h.LAST
        words[h.LOCK_HOLDER] = region.pid
        words[h.RECOVERIES] = words[h.RECOVERIES] + 1 & h.LAST
        return True


def _is_dead(pid: int) -> bool:
    """Return True if `pid`, read from the region, is the id of a process that no longer exists.

    Return False for the id of a PLC and for 0, because neither is the id of a process.
    """
    if not 0 < pid < 1 << 31:
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        pass
    return False
