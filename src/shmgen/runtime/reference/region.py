"""An open region: its memory map, its header fields and its semaphore."""

from __future__ import annotations

import io
import mmap
import os
from contextlib import suppress
from types import BuiltinMethodType
from typing import Any

import posix_ipc

from shmgen.core import abi
from shmgen.runtime.reference.memory_order import ordered
from shmgen.runtime.region import header as h
from shmgen.runtime.region.record_locks import READER_LOCK, WRITER_LOCK, unlock_byte

_call = BuiltinMethodType.__call__


class Semaphore:
    """A POSIX semaphore. With an empty name, a placeholder that is never acquired and never posted.

    `held` has one entry for each token that this process acquired and has not posted. A signal handler may raise
    between any two calls. Therefore one call into C acquires a token and adds its entry, and one call posts and clears
    the entries.
    """

    def __init__(self, name: str) -> None:
        """Open the semaphore `name`. Raises posix_ipc.ExistentialError and posix_ipc.PermissionsError."""
        self.is_there = bool(name)
        self._inner: Any = posix_ipc.Semaphore(name) if name else None
        self.held: list[None] = []

    @property
    def value(self) -> int:
        return int(self._inner.value) if self.is_there else 1

    def acquire(self) -> bool:
        """Acquire a token without waiting. Return False if no token is free."""
        if not self.is_there:
            return False
        try:
            self.held += map(self._inner.acquire, (0,))
        except posix_ipc.BusyError:
            return False
        return True

    def post(self) -> bool:
        """Release a token and clear `held`. If the semaphore already has a token, do nothing and return False.

        Two tokens would admit two holders at once, or end a later wait early.
        """
        if self.value > 0:
            return False
        any(map(_call, (self._inner.release, self.held.clear)))
        return True

    def close(self) -> None:
        with suppress(posix_ipc.ExistentialError):  # already closed, if the process was forked during a close
            if self.is_there:
                self._inner.close()


class Region:
    """The open region of one topic: its file, memory map, header and semaphore.

    `map` is for copies of many bytes. `words` and `quads` are for single loads and stores of 4 and 8 bytes. `pid` is
    the id of the process that opened the region.
    """

    def __init__(self, file: io.FileIO, map: mmap.mmap, header: h.Header, semaphore: Semaphore) -> None:
        self.header = header
        self.pid = os.getpid()
        self.map = map
        self.words = ordered(memoryview(map).cast("I"))
        self.quads = ordered(memoryview(map).cast("Q"))
        self.semaphore = semaphore
        self._file = file

    @property
    def file(self) -> int:
        """The file descriptor of the region."""
        return self._file.fileno()

    def newest(self) -> int:
        """Return the number of the newest sample, or 0 before the first."""
        return h.later(self.words[h.COMPLETED0], self.words[h.COMPLETED1])

    def slot(self, number: int, lane: int) -> int:
        """Return the offset in bytes of the slot of sample `number` in a lane, one of the two halves of the slots."""
        slots = self.header.slots
        return h.HEADER_SIZE + (number % slots + lane * slots) * self.header.slot_size

    def is_whole(self, number: int, slot: int) -> bool:
        """Return True if the slot at offset `slot` contains the complete sample `number`.

        While a writer changes a slot, the number in the slot is 0.
        """
        return self.words[slot // 4 + 2 * h.NUMBER] == number

    def find(self, number: int) -> int:
        """Return the offset in bytes of the slot with the complete sample `number`, or 0 if no slot has this sample.

        Search both lanes, the two halves of the region's slots. At most one lane has the sample.
        """
        slots = (self.slot(number, lane) for lane in range(abi.LANES))
        return next((slot for slot in slots if self.is_whole(number, slot)), 0)

    def payload(self, slot: int) -> slice:
        """Return the byte range of the message in the slot at offset `slot`."""
        return slice(slot + h.SLOT_HEADER, slot + h.SLOT_HEADER + self.header.payload_size)

    def close(self) -> None:
        """Close the file, the map and the semaphore. The region stays in /dev/shm for its other users.

        Release the record locks explicitly, because a forked child may keep the file open and with it the locks. In a
        forked child, keep the record locks, because the locks belong to the parent.
        """
        if os.getpid() == self.pid and not self._file.closed:
            for byte in (WRITER_LOCK, READER_LOCK):
                unlock_byte(self.file, byte)
        self.words.release()
        self.quads.release()
        self._file.close()
        self.semaphore.close()
        with suppress(BufferError):  # in a child that was forked during a copy
            self.map.close()
