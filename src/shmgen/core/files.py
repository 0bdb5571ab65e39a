"""Reads a file, and nothing else that may stand under its name."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def opened(path: str | Path) -> BinaryIO:
    """For reading, without waiting for the other end of a FIFO. Raises OSError, also where it is no file."""
    return open(path, "rb", opener=_only_files)


def content(path: str | Path) -> bytes:
    """All of it. Raises OSError."""
    descriptor = _only_files(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    try:
        pieces = []
        while piece := os.read(descriptor, _PIECE):
            pieces.append(piece)
        return b"".join(pieces)
    finally:
        os.close(descriptor)


_PIECE = 1 << 16
"""Bytes that are read at once; most files are shorter."""


def _only_files(path: str | Path, flags: int) -> int:
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "not a file", path)
