"""What keeps loads and stores in their order on this machine: nothing, a full barrier, or the lock alone."""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Callable
from typing import Any, cast

_KEEP = ("x86_64", "AMD64", "i386", "i486", "i586", "i686")
"""Machines on which a later load alone passes an earlier store."""
_EXPEDITED = 2
"""MEMBARRIER_CMD_GLOBAL_EXPEDITED of linux/membarrier.h (4.16): a full barrier for who calls, first and last."""
_NUMBERS = {
    ("aarch64", True): 283,
    ("riscv64", True): 283,
    ("aarch64", False): 389,
    ("armv8l", False): 389,
    ("armv7l", False): 389,
}
"""That of membarrier(2), by what os.uname() says and whether this process has 64 bits (asm/unistd.h)."""


def keeps_order() -> bool:
    """Whether loads and stores of this machine keep their order, so that the slots alone carry integrity."""
    return os.uname().machine in _KEEP


def has_barrier() -> bool:
    """Whether fence() is a full barrier here: on x86 always, elsewhere where Linux allows it."""
    return keeps_order() or _membarrier() is not None


def ordered(words: memoryview) -> memoryview:
    """The same words; where the machine keeps no order, each look at one and each store stands between two barriers."""
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
    """On x86 taking any mutex is a locked instruction, which is a full barrier; one of its own is free."""
    threading.Lock().acquire()


def _membarrier() -> Callable[[], Any] | None:
    """The system call, None where there is none or it is not allowed."""
    number = _NUMBERS.get((os.uname().machine, sys.maxsize > 2**32))
    if number is None:
        return None
    call = ctypes.CDLL(None).syscall
    arguments = [ctypes.c_long(value) for value in (number, _EXPEDITED, 0, 0)]
    return (lambda: call(*arguments)) if call(*arguments) == 0 else None


fence: Callable[[], Any] = _locked if keeps_order() else _membarrier() or _locked
"""Keeps loads and stores on their side of it, where has_barrier()."""
