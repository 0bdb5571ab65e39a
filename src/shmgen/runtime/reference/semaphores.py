"""Turns the name of a POSIX semaphore into what can be tried, posted and counted."""

from __future__ import annotations

from typing import Protocol

import posix_ipc


class Semaphore(Protocol):
    """What is asked of a semaphore."""

    @property
    def value(self) -> int: ...

    def acquire(self) -> bool:
        """Tries; True = taken."""

    def post(self) -> bool:
        """Posts unless there is a token already: two would let two in, or end a later wait early. True = posted."""

    def close(self) -> None: ...


class PosixSemaphore:
    """One that is there. Raises posix_ipc.ExistentialError and PermissionsError."""

    def __init__(self, name: str) -> None:
        self._inner = posix_ipc.Semaphore(name)

    @property
    def value(self) -> int:
        return int(self._inner.value)

    def acquire(self) -> bool:
        try:
            self._inner.acquire(0)
        except posix_ipc.BusyError:
            return False
        return True

    def post(self) -> bool:
        if self._inner.value > 0:
            return False
        self._inner.release()
        return True

    def close(self) -> None:
        self._inner.close()


class NoSemaphore:
    """Stands where a region has no lock: never taken, never posted."""

    value = 1

    def acquire(self) -> bool:
        return False

    def post(self) -> bool:
        return True

    def close(self) -> None:
        pass
