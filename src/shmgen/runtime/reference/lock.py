"""The region's lock, which nobody waits for longer than the time limit, and which recovers."""

from __future__ import annotations

import os
import time

from shmgen.core import abi
from shmgen.runtime.reference.memory_order import keeps_order
from shmgen.runtime.reference.region import Region
from shmgen.runtime.region import header as h
from shmgen.runtime.region.looks import lock_byte, unlock_byte

LOCK_TIMEOUT = abi.LOCK_MS / 1000
"""Seconds to wait for the lock, unless told otherwise, and longest single wait."""
_DEAD_AFTER = abi.DEAD_MS / 1000
_STUCK_AFTER = abi.RECOVER_MS / 1000
"""Seconds of one stay inside, after which the lock of a dead process, and of anybody else, is recovered."""
_PAUSE = 1e-4
"""Seconds between two tries: who is inside comes out within a few microseconds, if it has a processor."""
_SURPLUS = 64
"""Tokens too many that one call takes away at most."""


class Lock:
    """The lock of a region, or none.

    `keeps_order`: loads and stores of this machine keep their order (x86), or there is no lock, so the slots alone
    carry integrity and one may go on without. `misses` counts how often it was not free in time.
    """

    def __init__(self, region: Region, timeout: float) -> None:
        self.keeps_order = keeps_order() or not region.semaphore.is_there
        self.timeout = timeout
        self.misses = 0
        self._region = region
        # Who is inside when we open may be stuck: its time runs beside that in which a writer makes sure of its claim.
        self._seen: tuple[int, int] | None = self._stay() if region.semaphore.value == 0 else None
        self._since = time.monotonic()
        self._waited = False

    def acquire(self, left: float | None = None) -> bool:
        """Waits until the time limit; True = held. `left`: seconds of a call that ends then, where the lock is needed.

        Whoever gets in increments `lock_count` and then writes its name into `lock_holder`. While both stand where
        they stood at the first try that failed, one stay inside lasts: waiting again would cost the limit each time
        for nothing, until it has lasted for so long that its holder must be dead.
        """
        self.release()  # if a second exception interrupted the first's cleanup
        if self._region.semaphore.acquire() or self._wait(left):
            words = self._region.words
            words[h.LOCK_COUNT] = words[h.LOCK_COUNT] + 1 & h.LAST
            words[h.LOCK_HOLDER] = self._region.pid
            return True
        return False

    def release(self) -> None:
        """Gives it back, if it is held.

        Where a token is there already ours goes, and of others so many that the work stays bounded: a holder taken
        for dead has come back, two have recovered the lock, or somebody has posted.
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
            semaphore.post()  # we stood still in front of the post, and were taken for dead: it was one too many
            semaphore.held.clear()

    def _wait(self, left: float | None) -> bool:
        if not self._region.semaphore.is_there:
            return False  # which is no miss
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
        """Which stay inside this is. The count comes first, so the same pair with a holder is the same stay."""
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
        """Takes the dead holder's place, which the caller's release then ends; True = acquired.

        One process at a time, and each looks once more: had the one before only released, somebody who is in but has
        not incremented yet would be taken for dead in turn.
        """
        file = self._region.file
        try:
            try:
                taken = lock_byte(file, abi.REPAIR_LOCK) and self._take_place(stay)
            finally:
                unlock_byte(file, abi.REPAIR_LOCK)
        except BaseException:
            unlock_byte(file, abi.REPAIR_LOCK)  # where a signal handler's came upon the first
            raise
        return taken

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
    """Whether `pid`, a word of the region, is that of no process. A PLC and nobody have none."""
    if not 0 < pid < 1 << 31:
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        pass
    return False
