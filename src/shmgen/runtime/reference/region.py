"""A region that is open: its map, the words in it, and its record locks."""

from __future__ import annotations

import io
import mmap
import os
from contextlib import suppress

from shmgen.core import abi
from shmgen.runtime.reference.memory_order import ordered
from shmgen.runtime.reference.semaphores import Semaphore
from shmgen.runtime.region import header as h
from shmgen.runtime.region.looks import WRITER_LOCK, byte_is_locked, lock_byte, unlock_byte

REPAIR_LOCK = abi.REPAIR_LOCK
"""The byte under a record lock while the header is written, and while a lock is recovered."""


class Region:
    """One topic's shared memory: `map` for copies, `words` and `quads` for single loads and stores of 4 and 8 bytes.

    `pid` is that of the process that opened it, and `file` its descriptor.
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
        return self._file.fileno()

    def lock_byte(self, byte: int) -> bool:
        """Tries for a record lock."""
        return lock_byte(self.file, byte)

    def unlock_byte(self, byte: int) -> None:
        """Gives a record lock back."""
        unlock_byte(self.file, byte)

    def byte_is_locked(self, byte: int) -> bool:
        """Whether somebody else holds that record lock."""
        return byte_is_locked(self.file, byte)

    def slot(self, number: int) -> int:
        """Where the slot of sample `number` begins."""
        return h.HEADER_SIZE + number % self.header.slots * self.header.slot_size

    def payload(self, number: int) -> slice:
        """Where sample `number` lies, without the header of its slot."""
        start = self.slot(number) + h.SLOT_HEADER
        return slice(start, start + self.header.payload_size)

    def close(self) -> None:
        """Lets go of everything; the region stays for the peer.

        A child that was forked keeps the open file, and with it a claim that is not given back here.
        """
        if os.getpid() == self.pid and not self._file.closed:
            self.unlock_byte(WRITER_LOCK)
        self.words.release()
        self.quads.release()
        self._file.close()
        self.semaphore.close()
        with suppress(BufferError):  # in a child, forked in the middle of a copy
            self.map.close()
