"""Turns the name of a POSIX semaphore into what can be tried, released and counted, in some tens of nanoseconds."""

from __future__ import annotations

import ctypes
import os
import struct
import sys
import time
from typing import Any, Protocol

import posix_ipc

from shmgen.runtime.errors import RegionUnusable

try:
    from _multiprocessing import SemLock  # type: ignore[import-not-found]
except ImportError:  # a Python built without multiprocessing
    SemLock = None

LOCK_MOST = 1
"""The value to which a lock is released: more would let two in at a time."""
EVENT_MOST = 1
"""The value to which an event is posted: one post wakes a reader, and each more ends a later wait early."""

TOO_MANY = ("semaphore or lock released too many times",)
"""How the ValueError of a release that was refused is told from any other."""

_SEMAPHORE = 1
"""What SemLock calls a semaphore that any thread may release."""
_CLOCK_MONOTONIC = 1


_SIZES = (16, 32)
"""Bytes of sem_t in 32-bit and 64-bit processes, with glibc and with musl."""
_OURS = 32 if sys.maxsize > 2**32 else 16
_SHARING = struct.Struct("@8xI") if sys.maxsize > 2**32 else struct.Struct("@4xI")
_SHARED = (0, 128)
"""What says `shared` in musl and in glibc (nptl/sem_open.c: FUTEX_SHARED)."""


class Semaphore(Protocol):
    """What is asked of a semaphore. `handle` is the address of its sem_t, None where there is none to be had."""

    @property
    def handle(self) -> int | None: ...

    def acquire(self, block: bool, /) -> bool:
        """Tries, with False; True = taken."""

    def release(self) -> None:
        """Posts. Raises ValueError, and posts nothing, where the value is the greatest allowed already."""

    def _count(self) -> int:
        """How often it was taken through this object less how often it was released: exact at any instant, also
        where a signal handler raised before the result of a call had been stored.
        """

    def _get_value(self) -> int:
        """As sem_getvalue."""


def need_glibc(topic: str) -> None:
    """Raises RegionUnusable under any other C library: musl has its semaphores under the names of regions."""
    try:
        os.confstr("CS_GNU_LIBC_VERSION")
    except (OSError, ValueError):
        raise RegionUnusable(
            f"{topic}: a lock takes glibc's semaphores, which musl (Alpine) does not have: run this in an image with "
            'glibc, as Debian\'s, or write sync = "sequence" into shmgen.toml and generate both sides again'
        ) from None


class NoSemaphore:
    """Stands where a region has no lock: never entered, never posted."""

    handle = None

    def acquire(self, block: bool, /) -> bool:
        return False

    def release(self) -> None:
        pass

    def _count(self) -> int:
        return 0

    def _get_value(self) -> int:
        return 1


class PosixSemaphore:
    """posix_ipc behind the calls of SemLock: three times as slow, and there wherever this package is.

    Its count is kept in Python: a signal handler that raises between a call and the count is a token lost, which
    others recover as that of a dead process.
    """

    handle = None

    def __init__(self, name: str, most: int) -> None:
        self._semaphore = posix_ipc.Semaphore(name)
        self._most = most
        self._taken = 0

    def acquire(self, block: bool, /) -> bool:
        try:
            self._semaphore.acquire(None if block else 0)
        except posix_ipc.BusyError:
            return False
        self._taken += 1
        return True

    def release(self) -> None:
        if self._semaphore.value >= self._most:
            raise ValueError(*TOO_MANY)
        self._semaphore.release()
        self._taken -= 1

    def _count(self) -> int:
        return self._taken

    def _get_value(self) -> int:
        return int(self._semaphore.value)

    def __del__(self) -> None:
        if hasattr(self, "_semaphore"):
            self._semaphore.close()


def check(file: int, path: str) -> None:
    """Raises RegionUnusable for a file that is no semaphore: the C library believes what lies there.

    It maps as many bytes as its sem_t has, so that a process dies of SIGBUS where there are none, and aborts at a
    post where the word that says private or shared is neither. That of a program of other bitness it takes for held,
    or for free, for ever.
    """
    data = os.pread(file, max(_SIZES) + 1, 0)
    if len(data) in _SIZES and len(data) != _OURS:
        raise RegionUnusable(
            f"{path} was made by a program of {2 * len(data)} bits, this is one of {2 * _OURS}, and no semaphore "
            'crosses that: write sync = "sequence" under [regions] in shmgen.toml, generate both sides again, and '
            "remove it; or remove it, if it is a leftover: `shmgen clean`"
        )
    if len(data) != _OURS or _SHARING.unpack_from(data)[0] not in _SHARED:
        raise RegionUnusable(f"{path} is not a semaphore of this machine's C library: remove it and start again")


def opened(name: str, most: int) -> Semaphore:
    """The semaphore `/name`, which is there. Raises FileNotFoundError and PermissionError.

    SemLock is what multiprocessing is built on; unlike multiprocessing it tracks and removes nothing. A try and a
    release take 34 ns each, those of posix_ipc with a time limit 125, a quarter of a whole publish.
    """
    if SemLock is not None:
        found: Semaphore = SemLock._rebuild(0, _SEMAPHORE, most, name)
        return found
    try:
        return PosixSemaphore(name, most)
    except posix_ipc.ExistentialError as error:
        raise FileNotFoundError(str(error)) from None
    except posix_ipc.PermissionsError as error:
        raise PermissionError(str(error)) from None


def wait(semaphore: Any, seconds: float) -> bool:
    """Waits for a post by the clock that nobody sets; True = there was one. For events: what it takes nobody counts.

    `SemLock.acquire` waits until a time of day: set back an hour meanwhile, it waits an hour.
    """
    if _sem_clockwait is None or semaphore.handle is None:
        return _poll(semaphore, seconds)
    end = time.monotonic_ns() + int(seconds * 1e9)
    until = _Timespec(*divmod(end, 10**9))
    # errno is not asked for, which costs a microsecond: before the end it can only have been a signal.
    while _sem_clockwait(semaphore.handle, _CLOCK_MONOTONIC, until):
        if time.monotonic_ns() >= end:
            return False
    return True


def _poll(semaphore: Semaphore, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while not semaphore.acquire(False):
        left = end - time.monotonic()
        if left <= 0:
            return False
        time.sleep(min(left, 1e-3))
    return True


class _Timespec(ctypes.Structure):
    _fields_ = (("sec", ctypes.c_long), ("nsec", ctypes.c_long))


# In glibc since 2.30. Called through ctypes it lets other threads run meanwhile.
_sem_clockwait = getattr(ctypes.CDLL(None), "sem_clockwait", None)
if _sem_clockwait is not None:
    _sem_clockwait.argtypes = (ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(_Timespec))
