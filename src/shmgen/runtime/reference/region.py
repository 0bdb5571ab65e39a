"""A region that is open: its map, the words in it, and its semaphore."""

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
from shmgen.runtime.region.looks import READER_LOCK, WRITER_LOCK, unlock_byte

_call = BuiltinMethodType.__call__


class Semaphore:
    """One that is there; without a name none, which is never taken and never posted.

    `held` has an entry for each token that was taken and not given back. A signal handler may raise between any two
    calls. So a token is taken and noted, and given back and struck out, by one call of what is written in C.
    """

    def __init__(self, name: str) -> None:
        """Raises posix_ipc.ExistentialError and PermissionsError."""
        self.is_there = bool(name)
        self._inner: Any = posix_ipc.Semaphore(name) if name else None
        self.held: list[None] = []

    @property
    def value(self) -> int:
        return int(self._inner.value) if self.is_there else 1

    def acquire(self) -> bool:
        """Tries; True = taken."""
        if not self.is_there:
            return False
        try:
            self.held += map(self._inner.acquire, (0,))
        except posix_ipc.BusyError:
            return False
        return True

    def post(self) -> bool:
        """Posts unless there is a token already: two would let two in, or end a later wait early.

        True = posted, and nothing is held any more.
        """
        if self.value > 0:
            return False
        any(map(_call, (self._inner.release, self.held.clear)))
        return True

    def close(self) -> None:
        with suppress(posix_ipc.ExistentialError):  # closed already, in the middle of a close that was forked
            if self.is_there:
                self._inner.close()


class Region:
    """One topic's shared memory: `map` for copies, `words` and `quads` for single loads and stores of 4 and 8 bytes.

    `pid` is that of the process that opened it.
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
        """Its descriptor."""
        return self._file.fileno()

    def newest(self) -> int:
        """Number of the newest sample, 0 = none yet."""
        return h.later(self.words[h.COMPLETED0], self.words[h.COMPLETED1])

    def slot(self, number: int, lane: int) -> int:
        """Where the slot of sample `number` begins in that lane."""
        slots = self.header.slots
        return h.HEADER_SIZE + (number % slots + lane * slots) * self.header.slot_size

    def is_whole(self, number: int, slot: int) -> bool:
        """Whether sample `number` lies whole in that slot: the number is 0 while a writer is at it."""
        return self.words[slot // 4 + 2 * h.NUMBER] == number

    def find(self, number: int) -> int:
        """The slot in which sample `number` lies whole, 0 = in none. No number is in both lanes."""
        slots = (self.slot(number, lane) for lane in range(abi.LANES))
        return next((slot for slot in slots if self.is_whole(number, slot)), 0)

    def payload(self, slot: int) -> slice:
        """Where the message lies in a slot."""
        return slice(slot + h.SLOT_HEADER, slot + h.SLOT_HEADER + self.header.payload_size)

    def close(self) -> None:
        """Lets go of everything; the region stays for the peer.

        A child that was forked keeps the open file, and with it a claim that is not given back here.
        """
        if os.getpid() == self.pid and not self._file.closed:
            for byte in (WRITER_LOCK, READER_LOCK):
                unlock_byte(self.file, byte)
        self.words.release()
        self.quads.release()
        self._file.close()
        self.semaphore.close()
        with suppress(BufferError):  # in a child, forked in the middle of a copy
            self.map.close()
