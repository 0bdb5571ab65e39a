"""Turns a topic into its mapped region and semaphore, made or found in either order (ABI 1)."""

from __future__ import annotations

import errno
import fcntl
import io
import mmap
import os
import struct
import time
from contextlib import suppress
from typing import cast

import posix_ipc

from shmgen import abi
from shmgen.runtime import header as h
from shmgen.runtime.access import Access, RegionOptions, access_for, denied
from shmgen.runtime.closing import Gone
from shmgen.runtime.errors import LayoutMismatch, RegionMissing, RegionUnusable
from shmgen.runtime.names import event_name, region_file, region_name, semaphore_file
from shmgen.runtime.semaphores import EVENT_MOST, LOCK_MOST, NoSemaphore, Semaphore, opened

WRITER_LOCK = abi.WRITER_LOCK
"""The byte under a record lock as long as somebody publishes."""
REPAIR_LOCK = abi.REPAIR_LOCK
"""The byte under a record lock while the header is written, and while a lock is healed."""

_PATIENCE = abi.PEER_MS / 1000
"""Seconds to wait for a peer that is between two system calls; after that it is taken to be dead."""
_ATTEMPTS = 10
_FLOCK = struct.Struct("hhqqi4x")


class Region:
    """One topic's shared memory: `map` for copies, `words` and `quads` for single loads and stores of 4 and 8 bytes.

    `pid` is that of the process that opened it, and `file` its descriptor.
    """

    __slots__ = ("_file", "header", "map", "name", "options", "pid", "quads", "semaphore", "topic", "words")

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

    @property
    def file(self) -> int:
        return self._file.fileno()

    def lock_byte(self, byte: int) -> bool:
        """Tries for a record lock; it goes with the descriptor, also by SIGKILL."""
        return _lock_byte(self._file.fileno(), byte)

    def unlock_byte(self, byte: int) -> None:
        """Gives a record lock back."""
        _unlock_byte(self._file.fileno(), byte)

    def byte_is_locked(self, byte: int) -> bool:
        """Whether somebody else holds that record lock."""
        asked = _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0)
        kind, *_ = _FLOCK.unpack(fcntl.fcntl(self._file.fileno(), fcntl.F_OFD_GETLK, asked))
        return bool(kind != fcntl.F_UNLCK)

    def payload(self, number: int) -> slice:
        """Where sample `number` lies, without the header of its slot."""
        start = self.sample(number).start + h.SLOT_HEADER
        return slice(start, start + self.header.payload_size)

    def sample(self, number: int) -> slice:
        """Where sample `number` lies, the header of its slot first."""
        start = h.HEADER_SIZE + number % self.header.slots * self.header.slot_size
        return slice(start, start + h.SLOT_HEADER + self.header.payload_size)

    def close(self, gone: Gone | None = None) -> None:
        """Lets go of everything; the region stays for the peer. Whoever looks at `words` then meets `gone`."""
        if self._file.closed:
            return
        self.words.release()
        self.quads.release()
        if gone is not None:
            self.words = self.quads = cast(memoryview, gone)
        self._file.close()
        self.map.close()


def open_region(topic: str, ours: h.Header, options: RegionOptions = RegionOptions()) -> Region:  # noqa: B008 a tuple
    """Opens the topic's region and semaphore, or makes what is missing.

    `ours` is the header expected there. Raises ValueError for an impossible topic, LayoutMismatch,
    PermissionDenied and RegionUnusable.
    """
    name = region_name(topic)
    if options.sync == "sequence" and not keeps_order():
        raise RegionUnusable(
            f'{topic}: sync = "sequence" needs a machine that keeps the order of loads and stores, as x86-64 does; '
            f'this is {os.uname().machine}: write sync = "lock" into shmgen.toml and generate both sides again'
        )
    access = access_for(options)
    file = _open_memory(name, ours.size, access)
    try:
        _await_size(file, name, ours.size)
        _check(topic, ours, _peek(file.fileno()))
        map = mmap.mmap(file.fileno(), ours.size)
        _complete_header(file.fileno(), map, ours)
        _check(topic, ours, _peek(file.fileno()))
        return Region(topic, file, map, ours, _open_semaphore(name, 1, LOCK_MOST, options, access), options)
    except BaseException:
        file.close()
        raise


def open_event(region: Region) -> Semaphore:
    """Opens the semaphore that wakes a waiting reader, or makes it. Raises PermissionDenied, RegionUnusable."""
    options = region.options
    return _open_semaphore(event_name(region.name), 0, EVENT_MOST, options, access_for(options))


def keeps_order() -> bool:
    """Whether loads and stores of this machine keep their order, so that the slots alone carry integrity."""
    return os.uname().machine in ("x86_64", "AMD64")


def read_header(name: str) -> h.Header:
    """The header of the region `name` (`robot.pose`), whatever its type; `magic` tells whether it is one of ours.

    Raises RegionMissing and PermissionDenied.
    """
    try:
        memory = posix_ipc.SharedMemory("/" + name, read_only=True)
    except posix_ipc.ExistentialError:
        raise RegionMissing(f"{region_file(name)} does not exist: start a publisher or a subscriber of it") from None
    except posix_ipc.PermissionsError:
        raise denied(region_file(name)) from None
    try:
        return _peek(memory.fd)
    finally:
        memory.close_fd()


def _open_memory(name: str, size: int, access: Access) -> io.FileIO:
    path = region_file(name)
    for _ in range(_ATTEMPTS):
        try:
            # Without O_CREAT: `fs.protected_regular` refuses that for another user's file, even to root.
            with suppress(posix_ipc.ExistentialError):
                found = io.FileIO(posix_ipc.SharedMemory("/" + name).fd, "r+b")
                access.mend(found.fileno(), path)
                return found
            with suppress(posix_ipc.ExistentialError):
                made = io.FileIO(posix_ipc.SharedMemory("/" + name, posix_ipc.O_CREX, mode=access.made_mode).fd, "r+b")
                access.give(made.fileno(), path)
                _allocate(made, path, size)
                return made
        except posix_ipc.PermissionsError:
            raise denied(path) from None
    raise RegionUnusable(f"{path} keeps appearing and vanishing: something removes it; stop that and start again")


def _open_semaphore(name: str, value: int, most: int, options: RegionOptions, access: Access) -> Semaphore:
    if options.sync == "sequence":
        return NoSemaphore()
    path = semaphore_file(name)
    for _ in range(_ATTEMPTS):
        try:
            with suppress(FileNotFoundError):
                found = opened("/" + name, most)
                access.mend(path, path)
                return found
            with suppress(posix_ipc.ExistentialError):
                posix_ipc.Semaphore("/" + name, posix_ipc.O_CREX, mode=access.made_mode, initial_value=value).close()
                access.give(path, path)
        except (posix_ipc.PermissionsError, PermissionError):
            raise denied(path) from None
    raise RegionUnusable(f"{path} keeps appearing and vanishing: something removes it; stop that and start again")


def _await_size(file: io.FileIO, name: str, size: int) -> None:
    """Between shm_open and ftruncate of its maker an object has no bytes; who died there is stood in for."""
    deadline = time.monotonic() + _PATIENCE
    while os.fstat(file.fileno()).st_size == 0:
        if time.monotonic() > deadline:
            _allocate(file, region_file(name), size)
            return
        time.sleep(0.001)


def _allocate(file: io.FileIO, path: str, size: int) -> None:
    """As ftruncate, and takes the memory now: a full /dev/shm is an error here, not SIGBUS at the first store."""
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        file.close()
        if error.errno != errno.ENOSPC:
            raise
        raise RegionUnusable(f"{path}: no room for {size} bytes; see `df /dev/shm` (docker: `--shm-size`)") from None


def _complete_header(fd: int, map: mmap.mmap, ours: h.Header) -> None:
    """Whoever finds no magic writes the header, magic last; the record lock lets one Python do it at a time."""
    deadline = time.monotonic() + _PATIENCE
    while not (locked := _lock_byte(fd, REPAIR_LOCK)) and time.monotonic() < deadline:
        time.sleep(0.001)
    if _peek(fd).magic == 0:
        data = h.pack(ours)
        magic, *others = h.MADE
        for place in others:
            map[place] = data[place]
        with memoryview(map) as view, view[magic].cast("I") as word:
            word[0] = h.MAGIC
    if locked:
        _unlock_byte(fd, REPAIR_LOCK)


def _check(topic: str, ours: h.Header, theirs: h.Header) -> None:
    if theirs.magic == 0 and theirs.size == ours.size:
        return
    if theirs.fixed == ours.fixed:
        return
    name = region_name(topic)
    if theirs.digest == ours.digest and theirs.slots != ours.slots:
        advice = "the depth differs: configure the same depth on both sides"
    else:
        advice = "generate both sides from the same definitions and options"
    raise LayoutMismatch(
        f"{topic}: {region_file(name)} holds another layout\n"
        f"  there: {theirs}\n"
        f"  here:  {ours}\n"
        f"  {advice}; if the region is a leftover, remove it: `shmgen clean {topic}`"
    )


def _peek(fd: int) -> h.Header:
    return h.unpack(os.pread(fd, h.HEADER_SIZE, 0), os.fstat(fd).st_size)


def _lock_byte(fd: int, byte: int) -> bool:
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0))
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.EACCES):
            raise
        return False
    return True


def _unlock_byte(fd: int, byte: int) -> None:
    fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_UNLCK, os.SEEK_SET, byte, 1, 0))
