"""Turns the name of a POSIX semaphore into what can be tried, posted and counted."""

from __future__ import annotations

from contextlib import suppress
from types import BuiltinMethodType
from typing import Protocol

import posix_ipc

_call = BuiltinMethodType.__call__


class Semaphore(Protocol):
    """What is asked of a semaphore. `held` has an entry for each token that was taken and not given back."""

    held: list[None]

    @property
    def value(self) -> int: ...

    def acquire(self) -> bool:
        """Tries; True = taken."""

    def post(self) -> bool:
        """Posts unless there is a token already: two would let two in, or end a later wait early.

        True = posted, and nothing is held any more.
        """

    def close(self) -> None: ...


class PosixSemaphore:
    """One that is there. Raises posix_ipc.ExistentialError and PermissionsError.

    A signal handler may raise between any two calls. So a token is taken and noted, and given back and struck out, by
    one call of what is written in C.
    """

    def __init__(self, name: str) -> None:
        self._inner = posix_ipc.Semaphore(name)
        self.held: list[None] = []

    @property
    def value(self) -> int:
        return int(self._inner.value)

    def acquire(self) -> bool:
        try:
            self.held += map(self._inner.acquire, (0,))
        except posix_ipc.BusyError:
            return False
        return True

    def post(self) -> bool:
        if self._inner.value > 0:
            return False
        any(map(_call, (self._inner.release, self.held.clear)))
        return True

    def close(self) -> None:
        with suppress(posix_ipc.ExistentialError):  # closed already, in the middle of a close that was forked
            self._inner.close()


class NoSemaphore:
    """Stands where a region has no lock: never taken, never posted."""

    value = 1

    def __init__(self) -> None:
        self.held: list[None] = []

    def acquire(self) -> bool:
        return False

    def post(self) -> bool:
        return True

    def close(self) -> None:
        pass
