"""Set record locks on the file of a region, and find the process that holds one."""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from collections.abc import Iterator
from contextlib import suppress

from shmgen.core import abi
from shmgen.runtime.region import header as h

WRITER_LOCK = abi.WRITER_LOCK
"""The byte under a record lock while a publisher has the region open."""
READER_LOCK = abi.READER_LOCK
"""The byte under a record lock while subscribers have the region open. Subscribers share the lock."""
_FLOCK = struct.Struct("hhqqi4x")


def lock_byte(fd: int, byte: int, kind: int = fcntl.F_WRLCK) -> bool:
    """Try to set an open-file record lock on a byte. Return False if another open file holds the lock.

    The lock belongs to the open file, so the kernel releases the lock even after SIGKILL.
    """
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(kind, os.SEEK_SET, byte, 1, 0))
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.EACCES):
            raise
        return False
    return True


def byte_is_locked(fd: int, byte: int) -> bool:
    """Return True if another open file holds a record lock on the byte."""
    request = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0)
    kind, *_ = _FLOCK.unpack(fcntl.fcntl(fd, fcntl.F_OFD_GETLK, request))
    return bool(kind != fcntl.F_UNLCK)


def unlock_byte(fd: int, byte: int) -> None:
    """Release the record lock on a byte."""
    fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_UNLCK, os.SEEK_SET, byte, 1, 0))


def describe_writer(file: int, writer: int) -> str:
    """Return the text that names the writer of a region in messages: a process with its id, or "a PLC".

    `writer` is the value of the header field `writer`, and `file` is the descriptor of the region.
    """
    if byte_is_locked(file, WRITER_LOCK):
        pid = holder(file, WRITER_LOCK, writer)
        return f"process {pid}" if pid else f"process {writer} of another user or container"
    return "a PLC" if writer == h.PLC else f"process {writer}"


def holder(file: int, byte: int, preferred: int) -> int | None:
    """Return the id of the process that holds the record lock on `byte` of the open file descriptor `file`.

    Return None if no process holds the lock, or if /proc hides the process because the process belongs to another user
    or container. A process that has inherited the open file (a child of a fork that Python did not see) holds the lock
    as well. If several processes hold the lock, and `preferred`, the id in the region's header, is one of them, return
    `preferred`.
    """
    holders = list(_holders(os.fstat(file), byte))
    return preferred if preferred in holders else next(iter(holders), None)


def _holders(file: os.stat_result, byte: int) -> Iterator[int]:
    for pid in map(int, filter(str.isdecimal, os.listdir("/proc"))):
        with suppress(OSError):  # the process has ended, or belongs to another user
            for descriptor in os.listdir(f"/proc/{pid}/fd"):
                with suppress(OSError):
                    other = os.stat(f"/proc/{pid}/fd/{descriptor}")
                    if os.path.samestat(other, file) and _locks(f"/proc/{pid}/fdinfo/{descriptor}", byte):
                        yield pid
                        break


def _locks(info: str, byte: int) -> bool:
    """Return True if `info`, a file /proc/PID/fdinfo/N, lists an open-file record lock on the byte.

    A line is `lock: 1: OFDLCK ADVISORY WRITE -1 00:19:42 0 0`. Its last two numbers are the first and last byte.
    """
    with open(info, encoding="ascii") as lines:
        for line in lines:
            parts = line.split()
            if parts[0] == "lock:" and "OFDLCK" in parts:
                first, last = parts[-2:]
                if int(first) <= byte and (last == "EOF" or byte <= int(last)):
                    return True
    return False
