"""Read regular files only: if the path leads to a FIFO or a device, raise OSError and never block."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def open_file(path: str | Path) -> BinaryIO:
    """Open a regular file for reading. Raises OSError for a missing file, a FIFO or a device."""
    return open(path, "rb", opener=_open_regular)


def read_file(path: str | Path) -> bytes:
    """Return the content of a regular file. Raises OSError for a missing file, a FIFO or a device."""
    with open_file(path) as file:
        return file.read()


def _open_regular(path: str | Path, flags: int) -> int:
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EINVAL, "not a file", path)
