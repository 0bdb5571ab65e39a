"""Wakes the readers that sleep on the header field `bell` of a region (docs/protocol.md, "Wake-up and heartbeat")."""

from __future__ import annotations

import ctypes
import mmap
import os
import sys

from shmgen.runtime.region import header as h

_FUTEX = {"x86_64": 202, "aarch64": 98, "riscv64": 98}.get(os.uname().machine) if sys.maxsize > 2**32 else 240
"""The system call number of futex(2) (asm/unistd.h), or None if unknown here: then sleepers wake by their timeout."""
_WAKE = 1
_ALL = 2**31 - 1


def ring(map: mmap.mmap) -> None:
    """Wake all readers that wait for a new sample of the mapped region. Such readers sleep on the field `bell`."""
    if _FUTEX is not None:
        word = ctypes.c_uint32.from_buffer(map, 4 * h.BELL)
        ctypes.CDLL(None).syscall(ctypes.c_long(_FUTEX), ctypes.byref(word), _WAKE, _ALL, None, None, 0)
