"""Turns the region's semaphore into a lock that nobody waits for longer than the time limit, and that heals."""

from __future__ import annotations

import ctypes
import os
import threading
import time
from _multiprocessing import SemLock  # type: ignore[import-not-found]

from shmgen import abi
from shmgen.runtime import header as h
from shmgen.runtime.region import REPAIR_LOCK, NoSemaphore, Region, keeps_order

LOCK_TIMEOUT = abi.LOCK_MS / 1000
"""Seconds to wait for the lock, unless told otherwise."""
_DEAD_AFTER = abi.DEAD_MS / 1000
_STUCK_AFTER = abi.HEAL_MS / 1000
"""Seconds that nobody has got in, after which the lock of a dead process, and of anybody else, is taken over."""
_CLOCK_MONOTONIC = 1


class Lock:
    """What is done when a try of the semaphore failed; publisher and subscriber make the try themselves.

    `keeps_order`: loads and stores of this machine keep their order (x86-64), so the slots alone carry
    integrity and one may go on without the lock. `misses` counts how often that, or giving up, happened.
    """

    __slots__ = ("_count", "_region", "_since", "_waited", "keeps_order", "misses", "timeout")

    def __init__(self, region: Region, timeout: float) -> None:
        if not 0 <= timeout <= _STUCK_AFTER:
            raise ValueError(f"lock_timeout is {timeout}; it goes from 0 to {_STUCK_AFTER:.0f} second")
        self._region = region
        # What is held while we open may be stuck: its time runs beside that in which a writer makes sure of its claim.
        self._count: int | None = region.words[h.LOCK_COUNT] if region.semaphore._is_zero() else None
        self._since = time.monotonic()
        self._waited = False
        self.keeps_order = keeps_order()
        self.misses = 0
        self.timeout = timeout

    def wait(self) -> bool:
        """Waits for the lock until the time limit; True = inside.

        Whoever gets in counts `lock_count` up. While it stands where it stood at the last time-out the lock
        is taken to be stuck: waiting again would cost the limit each time for nothing, until it has stood for
        so long that its holder must be dead.
        """
        if isinstance(self._region.semaphore, NoSemaphore):
            return False  # which is no miss
        count = self._region.words[h.LOCK_COUNT]
        if count != self._count:
            self._count, self._since, self._waited = count, time.monotonic(), False
        if not self._waited:
            self._waited = True
            if acquire(self._region.semaphore, self.timeout):
                return True
        if self._overdue() and self._take_over(count):
            return True
        self.misses += 1
        return False

    def take_surplus(self) -> None:
        """Takes the semaphore down to 1: a holder that was taken for dead came back, or two sides have healed."""
        semaphore = self._region.semaphore
        if semaphore._get_value() > 1 and semaphore.acquire(False):
            while semaphore.acquire(False):
                pass
            semaphore.release()

    def _overdue(self) -> bool:
        stood = time.monotonic() - self._since
        return stood >= _STUCK_AFTER or (stood >= _DEAD_AFTER and _is_dead(self._region.words[h.LOCK_HOLDER]))

    def _take_over(self, count: int) -> bool:
        """Takes the dead holder's place, which the caller's release then ends; True = inside.

        One process at a time, and each looks once more: had the one before only released, somebody who is in
        but has not counted yet would be taken for dead in turn.
        """
        region = self._region
        if not region.lock_byte(REPAIR_LOCK):
            return False
        try:
            if acquire(region.semaphore, self.timeout):
                return True
            if region.words[h.LOCK_COUNT] != count:
                return False
            region.words[h.LOCK_HOLDER] = os.getpid()
            region.words[h.LOCK_COUNT] = count + 1 & 0xFFFFFFFF
            region.words[h.RECOVERIES] = region.words[h.RECOVERIES] + 1 & 0xFFFFFFFF
            return True
        finally:
            region.unlock_byte(REPAIR_LOCK)


def acquire(semaphore: SemLock, seconds: float) -> bool:
    """Waits for a semaphore by the clock that nobody sets.

    `SemLock.acquire` waits until a time of day: set back an hour meanwhile, it waits an hour.
    """
    if _sem_clockwait is None:
        return bool(semaphore.acquire(True, seconds))
    end = time.monotonic_ns() + int(seconds * 1e9)
    until = _Timespec(*divmod(end, 10**9))
    # errno is not asked for, which costs a microsecond: before the end it can only have been a signal.
    while _sem_clockwait(semaphore.handle, _CLOCK_MONOTONIC, until):
        if time.monotonic_ns() >= end:
            return False
    return True


def fence() -> None:
    """Keeps stores and loads on their side of it: taking any mutex is a locked instruction."""
    with _mutex:
        pass


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


class _Timespec(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_long), ("nsec", ctypes.c_long))


# In glibc since 2.30. Called through ctypes it lets other threads run meanwhile.
_sem_clockwait = getattr(ctypes.CDLL(None), "sem_clockwait", None)
if _sem_clockwait is not None:
    _sem_clockwait.argtypes = (ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(_Timespec))
_mutex = threading.Lock()
