"""Turns the region's semaphore into a lock that nobody waits for longer than the time limit, and that recovers."""

from __future__ import annotations

import os
import time

from shmgen.core import abi
from shmgen.runtime.region import header as h
from shmgen.runtime.region.memory_order import keeps_order
from shmgen.runtime.region.region import REPAIR_LOCK, Region
from shmgen.runtime.region.semaphores import TOO_MANY, NoSemaphore

LOCK_TIMEOUT = abi.LOCK_MS / 1000
"""Seconds to wait for the lock, unless told otherwise, and longest single wait."""
UNTIL_RECOVERED = (abi.RECOVER_MS + abi.PEER_MS) / 1000
"""The same for a writer where the lock is needed: whatever has become of its holder, it is free or recovered then."""
_DEAD_AFTER = abi.DEAD_MS / 1000
_STUCK_AFTER = abi.RECOVER_MS / 1000
"""Seconds of one stay inside, after which the lock of a dead process, and of anybody else, is taken over."""
_YIELDS = 20
"""Tries that follow each other at once: who is inside comes out within a few microseconds, if it has a processor."""
_PAUSE = 1e-4
"""Seconds between two tries after that."""
_SURPLUS = 64
"""Tokens too many that one call takes away at most."""


class Lock:
    """What is done when a try of the semaphore failed; publisher and subscriber make the try themselves.

    `keeps_order`: loads and stores of this machine keep their order (x86), or there is no lock, so the slots alone
    carry integrity and one may go on without. `misses` counts how often that, or giving up, happened.

    Whoever made the try itself calls leave() for any exception: a signal handler may raise at every call, also at
    the try, before its result is known. The semaphore counts inside its own call, so its count is always right.
    """

    __slots__ = ("_balance", "_region", "_repairing", "_seen", "_since", "_waited", "keeps_order", "misses", "timeout")

    def __init__(self, region: Region, timeout: float | None, where_needed: float = LOCK_TIMEOUT) -> None:
        """`timeout` None: LOCK_TIMEOUT, or `where_needed` on a machine where nobody goes on without the lock."""
        self.keeps_order = keeps_order() or isinstance(region.semaphore, NoSemaphore)
        if timeout is None:
            timeout = LOCK_TIMEOUT if self.keeps_order else where_needed
        elif not 0 <= timeout <= _STUCK_AFTER:
            raise ValueError(f"lock_timeout is {timeout}; it goes from 0 to {_STUCK_AFTER:.0f} second")
        self._region = region
        # Who is inside when we open may be stuck: its time runs beside that in which a writer makes sure of its claim.
        self._seen: tuple[int, int] | None = self._stay() if region.semaphore._get_value() == 0 else None
        self._since = time.monotonic()
        self._waited = False
        # What the semaphore's count is short of our being inside: places of dead ones taken, less tokens taken away.
        self._balance = 0
        self._repairing = False
        self.misses = 0
        self.timeout = timeout

    def wait(self, deadline: float | None = None) -> bool:
        """Waits for the lock until the time limit; True = acquired.

        `deadline`, by time.monotonic(), is that of the whole call: a limit beyond it ends there, and where the lock is
        needed one short of it lasts until then.

        Whoever gets in counts `lock_count` up and then writes its name into `lock_holder`. While both stand where
        they stood at the first try that failed, one stay inside lasts: waiting again would cost the limit each time
        for nothing, until it has lasted for so long that its holder must be dead. Only where the lock is needed there
        is nothing else to do.
        """
        if isinstance(self._region.semaphore, NoSemaphore):
            return False  # which is no miss
        self.leave()  # where an exception came upon an exception
        now, left = time.monotonic(), self.timeout
        if deadline is not None:
            left = min(left, deadline - now) if self.keeps_order else deadline - now
        end = now + left
        while not self._try_once_more(left):
            left = end - time.monotonic()
            if self.keeps_order or left <= 0:
                self.misses += 1
                return False
        return True

    def _try_once_more(self, left: float) -> bool:
        """Waits, `left` seconds at most, unless this stay has been waited for in vain, and recovers the lock."""
        stay = self._stay()
        if stay != self._seen:
            self._seen, self._since, self._waited = stay, time.monotonic(), False
        if not self._waited or not self.keeps_order:
            self._waited = True
            if self._try_for(left if self.keeps_order else min(left, LOCK_TIMEOUT)):
                return True
        return self._overdue(stay) and self._take_over(stay)

    def leave(self, error: BaseException | None = None) -> bool:
        """Gives back what this side holds, if it holds anything; for all ways out but the straight one.

        True: `error` only says that release() found a token there already, and all is done.
        """
        if self._repairing:
            self._region.unlock_byte(REPAIR_LOCK)
            self._repairing = False
        semaphore = self._region.semaphore
        if semaphore._count() + self._balance > 0:
            self._region.words[h.LOCK_HOLDER] = 0
            try:
                semaphore.release()
            except ValueError:
                self._take_surplus()
        return isinstance(error, ValueError) and error.args == TOO_MANY

    def forget(self) -> None:
        """In a forked child: what its parent holds, the parent gives back, however deep inside it was."""
        self._balance = -self._region.semaphore._count()
        self._repairing = False

    def _take_surplus(self) -> None:
        """For one who is inside and may not release: there is a token already.

        A holder taken for dead has come back, two sides have recovered it, or somebody has posted. Ours goes, and
        of others so many that the work stays bounded; what is left goes at the next times.
        """
        semaphore = self._region.semaphore
        for _ in range(_SURPLUS):
            if not semaphore.acquire(False):
                break
            self._balance -= 1
        try:
            semaphore.release()
        except ValueError:
            self._balance -= 1

    def _stay(self) -> tuple[int, int]:
        """Which stay inside this is. The count comes first, so the same pair with a holder is the same stay."""
        return self._region.words[h.LOCK_HOLDER], self._region.words[h.LOCK_COUNT]

    def _try_for(self, seconds: float) -> bool:
        """As often as it takes, by the clock that nobody sets.

        No single longer wait: what sem_clockwait takes the semaphore's own count does not know.
        """
        acquire = self._region.semaphore.acquire
        end = time.monotonic() + seconds
        yields = _YIELDS
        while not acquire(False):
            if time.monotonic() >= end:
                return False
            if yields:
                yields -= 1
                os.sched_yield()
            else:
                time.sleep(_PAUSE)
        return True

    def _overdue(self, stay: tuple[int, int]) -> bool:
        stood = time.monotonic() - self._since
        return stood >= _STUCK_AFTER or (stood >= _DEAD_AFTER and _is_dead(stay[0]))

    def _take_over(self, stay: tuple[int, int]) -> bool:
        """Takes the dead holder's place, which the caller's release then ends; True = acquired.

        One process at a time, and each looks once more: had the one before only released, somebody who is in
        but has not counted yet would be taken for dead in turn.
        """
        region, words = self._region, self._region.words
        self._repairing = True
        try:
            if not region.lock_byte(REPAIR_LOCK):
                return False
            if self._try_for(min(self.timeout, LOCK_TIMEOUT)):
                return True
            if self._stay() != stay:
                return False
            # No call, so no signal, between these: inside, and known to be.
            self._balance += 1
            words[h.LOCK_COUNT] = stay[1] + 1 & 0xFFFFFFFF
            words[h.LOCK_HOLDER] = region.pid
            words[h.RECOVERIES] = words[h.RECOVERIES] + 1 & 0xFFFFFFFF
            return True
        finally:
            region.unlock_byte(REPAIR_LOCK)
            self._repairing = False


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
