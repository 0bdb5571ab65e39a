"""Opens the region of a topic, created or found in either order, in steps that do not wait (docs/protocol.md).

Each generator yields a number where it has to wait for a peer, and goes on at its next step.
"""

from __future__ import annotations

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
from shmgen.runtime.region import header as h
from shmgen.runtime.region import looks
from shmgen.runtime.region.access import PATIENCE, Access, access_for, denied, opened
from shmgen.runtime.region.names import event_name, region_file, region_name, semaphore_file
from shmgen.runtime.region.resource import kept_from_children
from shmgen.runtime.region.settings import Settings

OTHER_MAKER = 2e-3
"""Seconds after which another maker of the same header has written his."""
_ATTEMPTS = 10
ADMIT, HEADER, SETTLE, WATCH, CONFIRM = range(1, 6)
"""What is waited for."""


def open_region(of: Settings, writes: bool = False) -> Generator[int, None, Region]:
    """Opens the topic's region and its lock, or creates what is missing.

    Raises LayoutMismatch, PermissionDenied, RegionUnusable; RegionMissing if passive, RegionInUse to a writer.
    """
    name = region_name(of.topic)
    if of.sequence and not has_barrier():
        raise RegionUnusable(
            f'{of.topic}: sync = "sequence" needs full memory barriers on {os.uname().machine}, and this Python has '
            "none: install shmgen with its extension in C (a compiler and Python's headers), or allow membarrier(2) "
            'here; between programs of one bitness sync = "lock" works as well'
        )
    if not of.sequence:
        looks.need_glibc(of.topic)
    passive = of.passive and (keeps_order() or of.sequence)
    if of.passive and not passive:
        looks.opened_to_read(name).close()
    for _ in range(_ATTEMPTS):
        with ExitStack() as so_far:
            file = so_far.enter_context(looks.opened_to_read(name) if passive else (yield from _open_file(of, name)))
            if not passive and (yield from _replaced(of, file, writes)):
                continue
            looks.check_header(of.topic, of.header, file)
            # From here on nobody of another layout replaces it.
            if writes and not looks.lock_byte(file.fileno(), looks.WRITER_LOCK):
                raise looks.in_use(of.topic, looks.writer_of(of.topic, file.fileno(), looks.peek(file.fileno()).writer))
            while not (passive or writes or looks.lock_byte(file.fileno(), looks.READER_LOCK, fcntl.F_RDLCK)):
                yield ADMIT
            with _system_errors(of, region_file(name)):
                protection = mmap.PROT_READ if passive else mmap.PROT_READ | mmap.PROT_WRITE
                # A map keeps a descriptor of its file, also in a child that is forked while a buffer of it is in use:
                # one of its own, without the record locks.
                with open(f"/proc/self/fd/{file.fileno()}", "rb" if passive else "r+b", buffering=0) as own:
                    map = kept_from_children(mmap.mmap(own.fileno(), of.header.size, prot=protection))
            so_far.enter_context(map)
            if not passive:
                yield from _complete_header(file.fileno(), map, of.header)
                looks.check_header(of.topic, of.header, file)
                if looks.peek(file.fileno()).retired:  # by one who has held those record locks before
                    continue
            semaphore = Semaphore("") if passive else (yield from open_semaphore(of, name, 1))
            if passive or looks.leads_to(region_file(name), file.fileno()):
                so_far.pop_all()
                region = Region(file, map, of.header, semaphore)
                if keeps_order() and not passive:
                    region.words[h.ORDERED] = 1
                return region
    raise looks.restless(region_file(name))


def open_event(of: Settings) -> Generator[int, None, Semaphore]:
    """Opens the semaphore that wakes a waiting reader, or makes it. Raises PermissionDenied, RegionUnusable."""
    return (yield from open_semaphore(of, event_name(region_name(of.topic)), 0))


def look_at(of: Settings) -> Generator[int, None, None]:
    """Opens all of a topic's files and closes them again. Raises as the two above."""
    (yield from open_region(of)).close()
    if not of.passive:
        (yield from open_event(of)).close()


def open_semaphore(of: Settings, name: str, value: int) -> Generator[int, None, Semaphore]:
    """The same for any, made with that value."""
    if of.sequence:
        return Semaphore("")
    path = semaphore_file(name)

    def make(access: Access) -> None:
        posix_ipc.Semaphore("/" + name, posix_ipc.O_CREX, access.made_mode, value).close()
        with suppress(FileNotFoundError), opened(path, os.O_RDWR) as made:
            access.give(made.fileno(), path)

    for _ in range(_ATTEMPTS):
        with (yield from _found_or_made(of, path, make)) as file:
            looks.check_semaphore(file.fileno(), path)
            with suppress(posix_ipc.ExistentialError), _system_errors(of, path):
                found = Semaphore("/" + name)
                if looks.leads_to(path, file.fileno()):  # by its name, which may have gone to another file since
                    return found
                found.close()
    raise looks.restless(path)


def _open_file(of: Settings, name: str) -> Generator[int, None, io.FileIO]:
    """The file of the region, that nobody can write without leave, and of a size."""
    path = region_file(name)

    def make(access: Access) -> None:
        how = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with kept_from_children(io.FileIO(os.open(path, how, access.made_mode), "r+b")) as made:
            try:
                access.give(made.fileno(), path)
                _allocate(made, of.header.size)
            except BaseException:
                # Whoever has opened it meanwhile sees at the end that the name leads elsewhere.
                if looks.leads_to(path, made.fileno()):
                    os.unlink(path)
                raise

    with ExitStack() as so_far:
        file = so_far.enter_context((yield from _found_or_made(of, path, make)))
        # Between shm_open and ftruncate of its maker an object has no bytes; who died there is stood in for.
        deadline = time.monotonic() + PATIENCE
        while os.fstat(file.fileno()).st_size == 0:
            if time.monotonic() > deadline:
                with _system_errors(of, path):
                    _allocate(file, of.header.size)
            else:
                yield ADMIT
        so_far.pop_all()
        return file


def _found_or_made(of: Settings, path: str, make: Callable[[Access], None]) -> Generator[int, None, io.FileIO]:
    """The open file of that path, once its maker has given it a group with which nobody can write it without leave."""
    access = access_for(of.options)
    for _ in range(_ATTEMPTS):
        with ExitStack() as so_far, _system_errors(of, path):
            # Without O_CREAT: `fs.protected_regular` refuses that for another user's file, even to root.
            with suppress(FileNotFoundError):
                file = so_far.enter_context(opened(path, os.O_RDWR))
                access.mend(file.fileno(), path)
                deadline = time.monotonic() + PATIENCE
                while objection := access.objection(os.fstat(file.fileno()), path):
                    if time.monotonic() > deadline:
                        who, leave = objection
                        raise PermissionDenied(f"{path}: {who}, and is not used\n  hint: {leave}")
                    yield ADMIT
                so_far.pop_all()
                return file
            with suppress(FileExistsError, posix_ipc.ExistentialError):
                make(access)
    raise looks.restless(path)


@contextmanager
def _system_errors(of: Settings, path: str) -> Iterator[None]:
    """Makes typed errors of what the system says."""
    try:
        yield
    except (PermissionError, posix_ipc.PermissionsError):
        raise denied(path) from None
    except OSError as error:
        if error.errno is None:  # posix_ipc has put it into words
            raise RegionUnusable(f"{path}: {error}; see `ulimit -a`") from None
        looks.refused_by_system(path, error.errno, of.header.size)


def _allocate(file: io.FileIO, size: int) -> None:
    """As ftruncate, and takes the memory now: a full /dev/shm is an error here, not SIGBUS at the first store."""
    os.posix_fallocate(file.fileno(), 0, size)


def _replaced(of: Settings, file: io.FileIO, writes: bool) -> Generator[int, None, bool]:
    """Takes the name away from a region of another layout; False: it has ours, or is in use.

    That is: somebody living writes it, or, where this is a reader, has it open. A PLC that reads it takes no record
    lock: it sees `retired`, and opens anew.
    """
    fd, end = file.fileno(), time.monotonic() + abi.CLAIM_MS / 1000
    if not looks.is_outdated(of.header, file):
        return False
    header = looks.peek(fd)
    if not header.retired:
        if not looks.lock_byte(fd, looks.WRITER_LOCK) or not (writes or looks.lock_byte(fd, looks.READER_LOCK)):
            return False
        before = header.heartbeat
        while header.writer == h.PLC and time.monotonic() < end:
            yield WATCH
            header = looks.peek(fd)
            if header.heartbeat != before:
                return False
    while not looks.retire(region_file(region_name(of.topic)), fd):
        yield ADMIT
    return True


def _complete_header(fd: int, map: mmap.mmap, ours: h.Header) -> Generator[int, None, None]:
    """Whoever finds no magic writes the header, magic last; the record lock lets one process do it at a time.

    A PLC may do it at the same time, of another layout: whoever has written looks again before anything is used.
    """
    deadline = time.monotonic() + PATIENCE
    try:
        while not looks.lock_byte(fd, abi.REPAIR_LOCK) and time.monotonic() < deadline:
            yield HEADER
        if looks.peek(fd).magic == 0:
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
        looks.unlock_byte(fd, abi.REPAIR_LOCK)
