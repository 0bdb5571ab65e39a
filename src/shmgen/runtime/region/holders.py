"""Finds the process that holds a record lock, which the kernel does not say of locks of the open-file kind."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress


def holder(file: int, byte: int, said: int) -> int | None:
    """The process that holds the lock on `byte` of the file behind descriptor `file`, by what /proc tells this user.

    None: nobody, or a process of another user or of another container. A process that has inherited the open file
    from the one that locked it (a child of a fork that Python was not told of) holds it as well: `said`, the one that
    has left its name, goes before others.
    """
    found = list(_holders(os.fstat(file), byte))
    return said if said in found else next(iter(found), None)


def _holders(file: os.stat_result, byte: int) -> Iterator[int]:
    for pid in map(int, filter(str.isdecimal, os.listdir("/proc"))):
        with suppress(OSError):  # it has ended, or is another user's
            for descriptor in os.listdir(f"/proc/{pid}/fd"):
                with suppress(OSError):
                    found = os.stat(f"/proc/{pid}/fd/{descriptor}")
                    if os.path.samestat(found, file) and _locks(f"/proc/{pid}/fdinfo/{descriptor}", byte):
                        yield pid
                        break


def _locks(info: str, byte: int) -> bool:
    """Lines as `lock: 1: OFDLCK ADVISORY WRITE -1 00:19:42 0 0`: the last two are the first and last byte."""
    with open(info, encoding="ascii") as lines:
        for line in lines:
            parts = line.split()
            if parts[0] == "lock:" and "OFDLCK" in parts:
                first, last = parts[-2:]
                if int(first) <= byte and (last == "EOF" or byte <= int(last)):
                    return True
    return False
