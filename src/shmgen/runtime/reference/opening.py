"""Opens or creates the region of a topic, in steps that do not wait (docs/protocol.md, "Create and remove").

Each generator yields a reason to wait (ADMIT to CONFIRM) instead of waiting for a peer, and then checks again.
"""

from __future__ import annotations

import errno
import fcntl
import io
import mmap
import os
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, contextmanager, suppress

import posix_ipc

from shmgen.core import abi
from shmgen.runtime.errors import PermissionDenied, RegionUnusable
from shmgen.runtime.reference.memory_order import fence, has_barrier, keeps_order
from shmgen.runtime.reference.region import Region, Semaphore
from shmgen.runtime.region import checks
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import PEER_TIMEOUT, Access, access_for, denied, opened
from shmgen.runtime.region.names import event_name, region_file, region_name, semaphore_file
from shmgen.runtime.region.record_locks import READER_LOCK, WRITER_LOCK, describe_writer, lock_byte, unlock_byte
from shmgen.runtime.region.resource import close_after_fork
from shmgen.runtime.region.settings import Settings

OTHER_MAKER = 2e-3
"""Seconds after which another program that creates the same region has finished its header."""
_ATTEMPTS = 10
ADMIT, HEADER, SETTLE, WATCH, CONFIRM = range(1, 6)
"""The reasons to wait: for a process (ADMIT, HEADER), a concurrent PLC (SETTLE, CONFIRM), or a heartbeat (WATCH)."""


def open_region(of: Settings, writes: bool = False) -> Generator[int, None, Region]:
    """Open the region and lock of a topic, or create the missing files. Return the open region.

    Raises LayoutMismatch, PermissionDenied and RegionUnusable. Raises RegionMissing if `of.passive` is set and the
    region does not exist. Raises RegionInUse if `writes` is set and another writer has the region open.
    """
    name = region_name(of.topic)
    if of.sequence and not has_barrier():
        raise RegionUnusable(
            f'{of.topic}: sync = "sequence" needs full memory barriers on {os.uname().machine}, which this Python '
            "lacks: install shmgen with its extension in C (a compiler and Python's headers), or allow membarrier(2). "
            'If all programs have the same bitness, sync = "lock" works as well'
        )
    if not of.sequence:
        checks.need_glibc(of.topic)
    passive = of.passive and (keeps_order() or of.sequence)
    if of.passive and not passive:
        checks.opened_to_read(name).close()
    for _ in range(_ATTEMPTS):
        with ExitStack() as so_far:
            file = so_far.enter_context(checks.opened_to_read(name) if passive else (yield from _open_file(of, name)))
            if not passive and (yield from _remove_outdated(of, file, writes)):
                continue
            checks.check_header(of.topic, of.header, file)
            # The record locks below prevent other processes from replacing the region by one of another layout.
            if writes and not lock_byte(file.fileno(), WRITER_LOCK):
                raise checks.region_in_use_error(
                    of.topic, describe_writer(file.fileno(), checks.read_header_of(file.fileno()).writer)
                )
            while not (passive or writes or lock_byte(file.fileno(), READER_LOCK, fcntl.F_RDLCK)):
                yield ADMIT
            with _system_errors(of, region_file(name)):
                protection = mmap.PROT_READ if passive else mmap.PROT_READ | mmap.PROT_WRITE
                # A map keeps a descriptor of its file open, also in a forked child while a buffer of the map is in use.
                # Therefore the map gets its own descriptor, without the record locks.
                with open(f"/proc/self/fd/{file.fileno()}", "rb" if passive else "r+b", buffering=0) as own:
                    map = close_after_fork(mmap.mmap(own.fileno(), of.header.size, prot=protection))
            so_far.enter_context(map)
            if not passive:
                yield from _complete_header(file.fileno(), map, of.header)
                checks.check_header(of.topic, of.header, file)
                if checks.read_header_of(file.fileno()).retired:  # by a process that held these record locks before
                    continue
            semaphore = Semaphore("") if passive else (yield from open_semaphore(of, name, 1))
            if passive or checks.leads_to(region_file(name), file.fileno()):
                so_far.pop_all()
                region = Region(file, map, of.header, semaphore)
                if keeps_order() and not passive:
                    region.words[h.ORDERED] = 1
                return region
    raise checks.file_vanishes_error(region_file(name))


def look_at(of: Settings) -> Generator[int, None, None]:
    """Open all files of a topic and close them again, so that a file that cannot be opened raises a typed error.

    The files are the region, its lock, and the semaphore that wakes a waiting reader. Raises the errors of
    open_region().
    """
    (yield from open_region(of)).close()
    if not of.passive:
        (yield from open_semaphore(of, event_name(region_name(of.topic)), 0)).close()


def open_semaphore(of: Settings, name: str, value: int) -> Generator[int, None, Semaphore]:
    """Open the semaphore `name`, or create it with the given value.

    Return a placeholder if the region has no lock. Raises PermissionDenied, or RegionUnusable for a damaged semaphore.
    """
    if of.sequence:
        return Semaphore("")
    path = semaphore_file(name)

    def make(access: Access) -> None:
        posix_ipc.Semaphore("/" + name, posix_ipc.O_CREX, access.creation_mode, value).close()
        with suppress(FileNotFoundError), opened(path, os.O_RDWR) as file:
            access.apply(file.fileno(), path)

    for _ in range(_ATTEMPTS):
        with (yield from _open_or_create(of, path, make)) as file:
            checks.check_semaphore(file.fileno(), path)
            with suppress(posix_ipc.ExistentialError), _system_errors(of, path):
                semaphore = Semaphore("/" + name)
                if checks.leads_to(path, file.fileno()):  # sem_open used the name, which may now refer to another file
                    return semaphore
                semaphore.close()
    raise checks.file_vanishes_error(path)


def _open_file(of: Settings, name: str) -> Generator[int, None, io.FileIO]:
    """Open or create the region's file `name`, and wait until its permissions are acceptable and its size is not 0."""
    path = region_file(name)

    def make(access: Access) -> None:
        how = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with close_after_fork(io.FileIO(os.open(path, how, access.creation_mode), "r+b")) as new:
            try:
                access.apply(new.fileno(), path)
                _allocate(new, path, of.header.size)
            except BaseException:
                # A process that has opened the file meanwhile notices the removal by its last check of the name.
                if checks.leads_to(path, new.fileno()):
                    os.unlink(path)
                raise

    with ExitStack() as so_far:
        file = so_far.enter_context((yield from _open_or_create(of, path, make)))
        # Between shm_open and ftruncate the file has 0 bytes. If its creator has died there, allocate the bytes here.
        deadline = time.monotonic() + PEER_TIMEOUT
        while os.fstat(file.fileno()).st_size == 0:
            if time.monotonic() > deadline:
                with _system_errors(of, path):
                    _allocate(file, path, of.header.size)
            else:
                yield ADMIT
        so_far.pop_all()
        return file


def _open_or_create(of: Settings, path: str, make: Callable[[Access], None]) -> Generator[int, None, io.FileIO]:
    """Open the file `path`, or create it with `make`. Return the open file when its permissions are acceptable.

    Raises PermissionDenied if other users can still write the file after PEER_TIMEOUT seconds.
    """
    access = access_for(of.options)
    for _ in range(_ATTEMPTS):
        with ExitStack() as so_far, _system_errors(of, path):
            # Open without O_CREAT: with `fs.protected_regular`, O_CREAT fails for files of other users, even for root.
            with suppress(FileNotFoundError):
                file = so_far.enter_context(opened(path, os.O_RDWR))
                access.correct(file.fileno(), path)
                deadline = time.monotonic() + PEER_TIMEOUT
                while objection := access.objection(os.fstat(file.fileno()), path):
                    if time.monotonic() > deadline:
                        who, leave = objection
                        raise PermissionDenied(f"{path}: the file is not used, because {who}\n  hint: {leave}")
                    yield ADMIT
                so_far.pop_all()
                return file
            with suppress(FileExistsError, posix_ipc.ExistentialError):
                make(access)
    raise checks.file_vanishes_error(path)


@contextmanager
def _system_errors(of: Settings, path: str) -> Iterator[None]:
    """Convert errors of the operating system into typed errors inside the `with` block."""
    try:
        yield
    except (PermissionError, posix_ipc.PermissionsError):
        raise denied(path) from None
    except OSError as error:
        if error.errno is None:  # the message of posix_ipc already describes the error
            raise RegionUnusable(f"{path}: {error}; see `ulimit -a`") from None
        checks.raise_system_error(path, error.errno, of.header.size)


def _allocate(file: io.FileIO, path: str, size: int) -> None:
    """Set a file's size and reserve its memory. A full /dev/shm then fails here, not by SIGBUS at the first store."""
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOSYS, errno.EOPNOTSUPP):
            raise
        raise RegionUnusable(
            f"{path}: the system call fallocate is refused here ({error.strerror}); allow it in the sandbox or the "
            "seccomp profile of this process"
        ) from None


def _remove_outdated(of: Settings, file: io.FileIO, writes: bool) -> Generator[int, None, bool]:
    """Remove a region that has another layout and that is not in use. Return True if the region was removed.

    A region is in use if a running writer has it open. If `writes` is False, a region that readers have open is in use
    as well. A PLC that only reads holds no record lock. The PLC finds `retired` in the header and reopens the region.
    """
    fd, end = file.fileno(), time.monotonic() + abi.CLAIM_MS / 1000
    if not checks.is_outdated(of.header, file):
        return False
    header = checks.read_header_of(fd)
    if not header.retired:
        if not lock_byte(fd, WRITER_LOCK) or not (writes or lock_byte(fd, READER_LOCK)):
            return False
        before = header.heartbeat
        while header.writer == h.PLC and time.monotonic() < end:
            yield WATCH
            header = checks.read_header_of(fd)
            if header.heartbeat != before:
                return False
    while not checks.retire(region_file(region_name(of.topic)), fd):
        yield ADMIT
    if header.newest and not header.retired:
        checks.log_replaced(of.topic, of.word, is_depth=header.digest == of.header.digest)
    return True


def _complete_header(fd: int, map: mmap.mmap, ours: h.Header) -> Generator[int, None, None]:
    """Write the header of a new region, in which the magic number is still 0. Write the magic number last.

    A record lock lets one process at a time write the header. A PLC needs no record lock, and may write a header of
    another layout at the same time. Therefore the caller checks the header again.
    """
    deadline = time.monotonic() + PEER_TIMEOUT
    try:
        while not lock_byte(fd, abi.REPAIR_LOCK) and time.monotonic() < deadline:
            yield HEADER
        if checks.read_header_of(fd).magic == 0:
            data = h.pack(ours)
            magic, *others = h.MADE
            for place in others:
                map[place] = data[place]
            fence()
            with memoryview(map) as view, view[magic].cast("I") as word:
                word[0] = h.MAGIC
            settled = time.monotonic() + OTHER_MAKER
            while time.monotonic() < settled:
                yield SETTLE
    finally:
        unlock_byte(fd, abi.REPAIR_LOCK)
