"""Memory barriers, which keep loads and stores of shared memory in order.

x86 needs a barrier only for large copies. Other machines need a full barrier for each access, or the lock if Linux does
not allow the system call membarrier(2).
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Callable
from typing import Any, cast

_KEEP = ("x86_64", "AMD64", "i386", "i486", "i586", "i686")
"""Machines on which the only reordering is that a later load passes an earlier store."""
_EXPEDITED = 2
"""MEMBARRIER_CMD_GLOBAL_EXPEDITED (linux/membarrier.h, Linux 4.16): a full barrier at entry and exit."""
_NUMBERS = {
    ("aarch64", True): 283,
    ("riscv64", True): 283,
    ("aarch64", False): 389,
    ("armv8l", False): 389,
    ("armv7l", False): 389,
}
"""The system call number of membarrier(2) (asm/unistd.h), by machine and by whether the process has 64 bits."""


def keeps_order() -> bool:
    """Return True if this machine keeps loads and stores in order (x86).

    Readers then need no lock: the number in a slot shows whether the sample was overwritten.
    """
    return os.uname().machine in _KEEP


def has_barrier() -> bool:
    """Return True if fence() is a full barrier here: always on x86, elsewhere if Linux allows membarrier(2)."""
    return keeps_order() or _membarrier() is not None


def ordered(words: memoryview) -> memoryview:
    """Return an object by which the header fields `words` are loaded and stored in order.

    On x86 the object is `words` itself. On other machines the object adds a barrier before and after each access.
    """
    return words if keeps_order() else cast(memoryview, _Ordered(words))


class _Ordered:
    def __init__(self, words: memoryview) -> None:
        self._words = words

    def __getitem__(self, at: int) -> int:
        fence()
        value = self._words[at]
        fence()
        return value

    def __setitem__(self, at: int, value: int) -> None:
        fence()
        self._words[at] = value
        fence()

    def release(self) -> None:
        self._words.release()


def _locked() -> None:
    """Provide a full memory barrier on x86, where acquiring a mutex executes a locked instruction.

    Each call creates a new mutex, which is always free.
    """
    threading.Lock().acquire()


def _membarrier() -> Callable[[], Any] | None:
    """Return a function that calls membarrier(2), or None if the system call is missing or not allowed."""
    number = _NUMBERS.get((os.uname().machine, sys.maxsize > 2**32))
    if number is None:
        return None
    call = ctypes.CDLL(None).syscall
    arguments = [ctypes.c_long(value) for value in (number, _EXPEDITED, 0, 0)]
    return (lambda: call(*arguments)) if call(*arguments) == 0 else None


fence: Callable[[], Any] = _locked if keeps_order() else _membarrier() or _locked
"""A full barrier, if has_barrier(): no load or store moves from one side of the call to the other."""
