"""A region that is open: its map, the words in it, and its record locks."""

from __future__ import annotations

import errno
import fcntl
import io
import mmap
import os
import struct
from contextlib import suppress
from typing import cast

from shmgen.core import abi
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import RegionOptions
from shmgen.runtime.region.memory_order import ordered
from shmgen.runtime.region.names import region_name
from shmgen.runtime.region.resource import ClosedProxy, kept_from_children
from shmgen.runtime.region.semaphores import Semaphore

WRITER_LOCK = abi.WRITER_LOCK
"""The byte under a record lock as long as somebody publishes."""
REPAIR_LOCK = abi.REPAIR_LOCK
"""The byte under a record lock while the header is written, and while a lock is recovered."""

_FLOCK = struct.Struct("hhqqi4x")


class Region:
    """One topic's shared memory: `map` for copies, `words` and `quads` for single loads and stores of 4 and 8 bytes.

    `pid` is that of the process that opened it, and `file` its descriptor.
    """

    __slots__ = (
        *("__weakref__", "_file", "header", "map", "name"),
        *("options", "pid", "quads", "semaphore", "topic", "words"),
    )

    def __init__(
        self,
        topic: str,
        file: io.FileIO,
        map: mmap.mmap,
        header: h.Header,
        semaphore: Semaphore,
        options: RegionOptions,
    ) -> None:
        self.topic = topic
        self.options = options
        self.name = region_name(topic)
        self.header = header
        self.pid = os.getpid()
        self.map = map
        self.words = memoryview(map).cast("I")
        self.quads = memoryview(map).cast("Q")
        self.semaphore = semaphore
        self._file = file
        kept_from_children(self)
        self.words, self.quads = ordered(self.words), ordered(self.quads)

    @property
    def file(self) -> int:
        return self._file.fileno()

    def lock_byte(self, byte: int) -> bool:
        """Tries for a record lock; it goes with the descriptor, also by SIGKILL."""
        return lock_byte(self._file.fileno(), byte)

    def unlock_byte(self, byte: int) -> None:
        """Gives a record lock back."""
        unlock_byte(self._file.fileno(), byte)

    def byte_is_locked(self, byte: int) -> bool:
        """Whether somebody else holds that record lock."""
        return byte_is_locked(self._file.fileno(), byte)

    def payload(self, number: int) -> slice:
        """Where sample `number` lies, without the header of its slot."""
        start = self.sample(number).start + h.SLOT_HEADER
        return slice(start, start + self.header.payload_size)

    def sample(self, number: int) -> slice:
        """Where sample `number` lies, the header of its slot first."""
        start = h.HEADER_SIZE + number % self.header.slots * self.header.slot_size
        return slice(start, start + h.SLOT_HEADER + self.header.payload_size)

    def close(self, gone: ClosedProxy | None = None) -> None:
        """Lets go of everything; the region stays for the peer. Whoever looks at `words` then meets `gone`.

        Once is enough, but where an exception or a fork came upon it: the map has a descriptor, and the claim, as well.
        """
        for view in (self.words, self.quads):
            if not isinstance(view, ClosedProxy):
                view.release()
        if gone is not None:
            self.words = self.quads = cast(memoryview, gone)
        if not self._file.closed and os.getpid() == self.pid:
            self.unlock_byte(WRITER_LOCK)  # a child that was forked just now may not have closed the file yet
        self._file.close()
        unmap(self.map)


def unmap(map: mmap.mmap) -> None:
    """Its descriptor too."""
    with suppress(BufferError):  # in a child, forked in the middle of a copy
        map.close()


def lock_byte(fd: int, byte: int) -> bool:
    """Tries for a record lock of the open-file kind."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0))
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.EACCES):
            raise
        return False
    return True


def byte_is_locked(fd: int, byte: int) -> bool:
    """Whether another open file holds it."""
    asked = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0)
    kind, *_ = _FLOCK.unpack(fcntl.fcntl(fd, fcntl.F_OFD_GETLK, asked))
    return bool(kind != fcntl.F_UNLCK)


def unlock_byte(fd: int, byte: int) -> None:
    """Gives it back."""
    fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_UNLCK, os.SEEK_SET, byte, 1, 0))
