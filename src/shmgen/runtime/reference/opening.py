"""Turns a topic into its open region, created or found in either order, in steps that do not wait (docs/protocol.md).

Each generator yields a number where it has to wait for a peer, and goes on at its next step.
"""

from __future__ import annotations

import io
import mmap
import os
import time
from collections.abc import Generator
from contextlib import ExitStack, suppress
from typing import cast

import posix_ipc

from shmgen.runtime.errors import PermissionDenied, RegionUnusable
from shmgen.runtime.reference.memory_order import fence, has_barrier, keeps_order
from shmgen.runtime.reference.region import REPAIR_LOCK, Region
from shmgen.runtime.reference.semaphores import NoSemaphore, PosixSemaphore, Semaphore
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import PATIENCE, Access, access_for, denied, opened
from shmgen.runtime.region.looks import (
    check_header,
    check_semaphore,
    lock_byte,
    need_glibc,
    opened_to_read,
    peek,
    refused_by_system,
    restless,
    unlock_byte,
)
from shmgen.runtime.region.names import event_name, region_file, region_name, semaphore_file
from shmgen.runtime.region.resource import kept_from_children
from shmgen.runtime.region.settings import Settings

OTHER_MAKER = 2e-3
"""Seconds after which another maker of the same header has written his."""
_ATTEMPTS = 10
ADMIT, HEADER, SETTLE, WATCH, CONFIRM = range(1, 6)
"""What is waited for."""


def open_region(of: Settings) -> Generator[int, None, Region]:
    """Opens the topic's region and its lock, or creates what is missing.

    Raises LayoutMismatch, PermissionDenied, RegionUnusable; for a passive reader RegionMissing.
    """
    if of.sequence and not has_barrier():
        raise RegionUnusable(
            f'{of.topic}: sync = "sequence" needs full memory barriers on {os.uname().machine}, and this Python has '
            "none: install shmgen with its extension in C (a compiler and Python's headers), or allow membarrier(2) "
            'here; between programs of one bitness sync = "lock" works as well'
        )
    if not of.sequence:
        need_glibc(of.topic)
    passive = of.passive and (keeps_order() or of.sequence)
    if of.passive and not passive:
        opened_to_read(region_name(of.topic)).close()
    for _ in range(_ATTEMPTS):
        with ExitStack() as so_far:
            found = opened_to_read(region_name(of.topic)) if passive else (yield from _open_file(of))
            file = so_far.enter_context(found)
            check_header(of.topic, of.header, file)
            map = so_far.enter_context(_mapped(of, file, passive))
            semaphore: Semaphore = NoSemaphore()
            if not passive:
                yield from _complete_header(file.fileno(), map, of.header)
                check_header(of.topic, of.header, file)
                semaphore = yield from open_semaphore(of, region_name(of.topic), 1)
            if passive or _leads_to(region_file(region_name(of.topic)), file):
                so_far.pop_all()
                return Region(file, map, of.header, semaphore)
    raise restless(region_file(region_name(of.topic)))


def open_event(of: Settings) -> Generator[int, None, Semaphore]:
    """Opens the semaphore that wakes a waiting reader, or makes it. Raises PermissionDenied, RegionUnusable."""
    return (yield from open_semaphore(of, event_name(region_name(of.topic)), 0))


def open_semaphore(of: Settings, name: str, value: int) -> Generator[int, None, Semaphore]:
    """The same for any, made with that value."""
    if of.sequence:
        return NoSemaphore()
    access, path = access_for(of.options), semaphore_file(name)
    for _ in range(_ATTEMPTS):
        try:
            with suppress(FileNotFoundError), opened(path, os.O_RDWR) as file:
                access.mend(file.fileno(), path)
                yield from _admitted(access, file, path)
                check_semaphore(file.fileno(), path)
                found = PosixSemaphore("/" + name)
                if _leads_to(path, file):  # by its name, which may have gone to another file since
                    return found
                found.close()
                continue
            with suppress(posix_ipc.ExistentialError, FileNotFoundError):
                posix_ipc.Semaphore("/" + name, posix_ipc.O_CREX, access.made_mode, value).close()
                with opened(path, os.O_RDWR) as made:
                    access.give(made.fileno(), path)
        except (posix_ipc.PermissionsError, PermissionError):
            raise denied(path) from None
        except posix_ipc.ExistentialError:
            continue
        except (posix_ipc.Error, OSError) as error:
            raise RegionUnusable(f"{path}: {error}; see `ulimit -a` and `df /dev/shm`") from None
    raise restless(path)


def _open_file(of: Settings) -> Generator[int, None, io.FileIO]:
    """The file of the region, that nobody can write without leave, and of a size."""
    path, access = region_file(region_name(of.topic)), access_for(of.options)
    file = _found_or_made(of, path, access)
    try:
        yield from _admitted(access, file, path)
        # Between shm_open and ftruncate of its maker an object has no bytes; who died there is stood in for.
        deadline = time.monotonic() + PATIENCE
        while os.fstat(file.fileno()).st_size == 0:
            if time.monotonic() > deadline:
                _allocate(file, path, of.header.size)
            else:
                yield ADMIT
    except BaseException:
        file.close()
        raise
    return file


def _found_or_made(of: Settings, path: str, access: Access) -> io.FileIO:
    for _ in range(_ATTEMPTS):
        try:
            # Without O_CREAT: `fs.protected_regular` refuses that for another user's file, even to root.
            with suppress(FileNotFoundError):
                file = opened(path, os.O_RDWR)
                access.mend(file.fileno(), path)
                return file
            with suppress(FileExistsError):
                flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
                made = kept_from_children(io.FileIO(os.open(path, flags, access.made_mode), "r+b"))
                return _given(made, path, access, of.header.size)
        except PermissionError:
            raise denied(path) from None
        except OSError as error:
            refused_by_system(path, error.errno or 0, of.header.size)
    raise restless(path)


def _given(made: io.FileIO, path: str, access: Access, size: int) -> io.FileIO:
    """A file made just now, with its mode, its group and its bytes; or none at all."""
    try:
        access.give(made.fileno(), path)
        _allocate(made, path, size)
    except BaseException:
        # Whoever has opened it meanwhile sees at the end that the name leads elsewhere.
        if _leads_to(path, made):
            os.unlink(path)
        made.close()
        raise
    return made


def _admitted(access: Access, file: io.FileIO, path: str) -> Generator[int, None, None]:
    """Waits for the file's maker, who may be about to give it its group. Raises PermissionDenied."""
    deadline = time.monotonic() + PATIENCE
    while objection := access.objection(os.fstat(file.fileno()), path):
        if time.monotonic() > deadline:
            who, leave = objection
            raise PermissionDenied(f"{path}: {who}, and is not used\n  hint: {leave}")
        yield ADMIT


def _mapped(of: Settings, file: io.FileIO, passive: bool) -> mmap.mmap:
    try:
        access = mmap.PROT_READ | (0 if passive else mmap.PROT_WRITE)
        return cast(mmap.mmap, kept_from_children(mmap.mmap(file.fileno(), of.header.size, prot=access)))
    except OSError as error:
        refused_by_system(region_file(region_name(of.topic)), error.errno or 0, of.header.size)


def _allocate(file: io.FileIO, path: str, size: int) -> None:
    """As ftruncate, and takes the memory now: a full /dev/shm is an error here, not SIGBUS at the first store."""
    try:
        os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        refused_by_system(path, error.errno or 0, size)


def _complete_header(fd: int, map: mmap.mmap, ours: h.Header) -> Generator[int, None, None]:
    """Whoever finds no magic writes the header, magic last; the record lock lets one process do it at a time.

    A PLC may do it at the same time, of another layout: whoever has written looks again before anything is used.
    """
    deadline = time.monotonic() + PATIENCE
    try:
        while not lock_byte(fd, REPAIR_LOCK) and time.monotonic() < deadline:
            yield HEADER
        if peek(fd).magic == 0:
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
        unlock_byte(fd, REPAIR_LOCK)


def _leads_to(path: str, file: io.FileIO) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), os.lstat(path))
    except OSError:
        return False
