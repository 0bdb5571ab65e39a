"""Turns a path into the bytes of the file there, and of nothing else that may stand there."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def opened(path: str | Path, buffering: int = -1) -> BinaryIO:
    """For reading, without waiting for the other end of a FIFO. Raises OSError, also where it is no file."""
    return open(path, "rb", buffering, opener=_only_files)


def content(path: str | Path) -> bytes:
    """All of it. Raises OSError."""
    with opened(path, 0) as file:
        return file.read()


def _only_files(path: str, flags: int) -> int:
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "not a file", path)
