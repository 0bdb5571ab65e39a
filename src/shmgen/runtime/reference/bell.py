"""Wakes those who sleep on the bell of a region (docs/protocol.md, "Wake-up")."""

from __future__ import annotations

import ctypes
import mmap
import os
import sys

from shmgen.runtime.region import header as h

_FUTEX = {"x86_64": 202, "aarch64": 98, "riscv64": 98}.get(os.uname().machine) if sys.maxsize > 2**32 else 240
"""The number of futex(2) (asm/unistd.h); None: not known here, and who sleeps wakes by itself."""
_WAKE = 1
_ALL = 2**31 - 1


def ring(map: mmap.mmap) -> None:
    """Wakes all of them."""
    if _FUTEX is not None:
        word = ctypes.c_uint32.from_buffer(map, 4 * h.BELL)
        ctypes.CDLL(None).syscall(ctypes.c_long(_FUTEX), ctypes.byref(word), _WAKE, _ALL, None, None, 0)
