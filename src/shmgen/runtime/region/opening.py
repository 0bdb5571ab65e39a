"""Turns a topic into its mapped region and semaphore, created or found in either order (ABI 1)."""

from __future__ import annotations

import errno
import io
import mmap
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

import posix_ipc

from shmgen.runtime.errors import LayoutMismatch, RegionMissing, RegionUnusable
from shmgen.runtime.region import header as h
from shmgen.runtime.region import semaphores
from shmgen.runtime.region.access import PATIENCE, Access, RegionOptions, access_for, denied, opened
from shmgen.runtime.region.memory_order import fence, has_barrier, keeps_order
from shmgen.runtime.region.names import event_name, region_file, region_name, semaphore_file
from shmgen.runtime.region.region import REPAIR_LOCK, Region, lock_byte, unlock_byte, unmap
from shmgen.runtime.region.resource import kept_from_children
from shmgen.runtime.region.semaphores import EVENT_MOST, LOCK_MOST, NoSemaphore, Semaphore

_OTHER_MAKER = 2e-3
"""Seconds after which another maker of the same header has written his."""
_ATTEMPTS = 10
_LARGER_PAGES = (16384, 65536)
"""Bytes: on a Raspberry Pi 5 and Apple's machines, and in kernels for servers with ARM or POWER."""


def open_region(topic: str, ours: h.Header, options: RegionOptions = RegionOptions()) -> Region:  # noqa: B008 a tuple
    """Opens the topic's region and semaphore, or creates what is missing.

    `ours` is the header expected there. Raises ValueError for an impossible topic, LayoutMismatch,
    PermissionDenied and RegionUnusable.
    """
    name = region_name(topic)
    if options.sync == "sequence" and not has_barrier():
        raise RegionUnusable(
            f'{topic}: sync = "sequence" needs full memory barriers on {os.uname().machine}, and this Python has none: '
            f"install shmgen with its extension in C (a compiler and Python's headers), or allow membarrier(2) here; "
            'between programs of one bitness sync = "lock" works as well'
        )
    if options.sync == "lock":
        semaphores.need_glibc(topic)
    access = access_for(options)
    for _ in range(_ATTEMPTS):
        with ExitStack() as ours_so_far:
            file = ours_so_far.enter_context(_open_memory(name, ours.size, access))
            _await_size(file, name, ours.size)
            _check(topic, ours, file)
            with _typed(region_file(name)):
                map = kept_from_children(mmap.mmap(file.fileno(), ours.size))
            ours_so_far.callback(unmap, map)
            _complete_header(file.fileno(), map, ours)
            _check(topic, ours, file)
            semaphore = _open_semaphore(name, 1, LOCK_MOST, options, access)
            if _leads_to(region_file(name), file):
                region = Region(topic, file, map, ours, semaphore, options)
                ours_so_far.pop_all()
                return region
    raise _restless(region_file(name))


def open_event(region: Region) -> Semaphore:
    """Opens the semaphore that wakes a waiting reader, or makes it. Raises PermissionDenied, RegionUnusable."""
    options = region.options
    return _open_semaphore(event_name(region.name), 0, EVENT_MOST, options, access_for(options))


def watch_region(topic: str, ours: h.Header, options: RegionOptions) -> Region:
    """Opens a region that is there, to be read only: without lock and event, unless the lock keeps the order here.

    Raises as open_region(), and RegionMissing.
    """
    with ExitStack() as ours_so_far:
        file = ours_so_far.enter_context(opened_to_read(region_name(topic)))
        _check(topic, ours, file)
        if options.sync == "lock" and not keeps_order():
            return open_region(topic, ours, options)
        with _typed(region_file(region_name(topic))):
            map = kept_from_children(mmap.mmap(file.fileno(), ours.size, prot=mmap.PROT_READ))
        ours_so_far.pop_all()
        return Region(topic, file, map, ours, NoSemaphore(), options)


def read_header(name: str) -> h.Header:
    """The header of the region `name` (`robot.pose`), whatever its type; `magic` shows whether it is one of shmgen's.

    Raises RegionMissing, PermissionDenied and RegionUnusable.
    """
    with opened_to_read(name) as file:
        return _peek(file.fileno())


def opened_to_read(name: str) -> io.FileIO:
    """The file of the region `name`. Raises as read_header()."""
    path = region_file(name)
    try:
        return opened(path, os.O_RDONLY)
    except FileNotFoundError:
        raise RegionMissing(f"{path} does not exist: start a publisher or a subscriber of it") from None
    except PermissionError:
        raise denied(path) from None


def foreign(path: str, header: h.Header) -> RegionUnusable:
    """What to say of a file that something else has made."""
    hint = f"`ls -l {path}` shows whose it is; remove it, or use another topic"
    return RegionUnusable(f"{path} is {header}\n  hint: {hint}")


def _open_memory(name: str, size: int, access: Access) -> io.FileIO:
    path = region_file(name)
    for _ in range(_ATTEMPTS):
        try:
            # Without O_CREAT: `fs.protected_regular` refuses that for another user's file, even to root.
            with suppress(FileNotFoundError):
                return _found(path, access)
            with suppress(posix_ipc.ExistentialError):
                return _made(name, size, access)
        except (posix_ipc.PermissionsError, PermissionError):
            raise denied(path) from None
    raise _restless(path)


def _made(name: str, size: int, access: Access) -> io.FileIO:
    """A new one, or none at all. Raises posix_ipc.ExistentialError where one is there."""
    path = region_file(name)
    with _typed(path):
        descriptor = posix_ipc.SharedMemory("/" + name, posix_ipc.O_CREX, mode=access.made_mode).fd
        made = kept_from_children(io.FileIO(descriptor, "r+b"))
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


def _open_semaphore(name: str, value: int, most: int, options: RegionOptions, access: Access) -> Semaphore:
    if options.sync == "sequence":
        return NoSemaphore()
    path = semaphore_file(name)
    for _ in range(_ATTEMPTS):
        try:
            with suppress(FileNotFoundError), _found(path, access) as file:
                semaphores.check(file.fileno(), path)
                with _typed(path):
                    found = semaphores.opened("/" + name, most)
                # By its name, which may have gone to another file since.
                if _leads_to(path, file):
                    return found
                continue
            with suppress(posix_ipc.ExistentialError, FileNotFoundError):
                with _typed(path):
                    posix_ipc.Semaphore("/" + name, posix_ipc.O_CREX, access.made_mode, value).close()
                with opened(path, os.O_RDWR) as made:
                    access.give(made.fileno(), path)
        except (posix_ipc.PermissionsError, PermissionError):
            raise denied(path) from None
    raise _restless(path)


def _leads_to(path: str, file: io.FileIO) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), os.lstat(path))
    except OSError:
        return False


def _restless(path: str) -> RegionUnusable:
    return RegionUnusable(f"{path} keeps appearing and vanishing: something removes it; stop that and start again")


@contextmanager
def _typed(path: str) -> Iterator[None]:
    """What the operating system refuses, as an error of ours; but for who may, and whether it is there."""
    try:
        yield
    except (PermissionError, FileNotFoundError, posix_ipc.PermissionsError, posix_ipc.ExistentialError):
        raise
    except (OSError, posix_ipc.Error) as error:
        raise RegionUnusable(f"{path}: {error}; see `ulimit -a` and `df /dev/shm`") from None


def _found(path: str, access: Access) -> io.FileIO:
    """A file that is there, put right and looked at before anything of it is believed. Raises as opened()."""
    file = opened(path, os.O_RDWR)
    try:
        access.mend(file.fileno(), path)
        access.admit(file.fileno(), path)
    except BaseException:
        file.close()
        raise
    return file


def _await_size(file: io.FileIO, name: str, size: int) -> None:
    """Between shm_open and ftruncate of its maker an object has no bytes; who died there is stood in for."""
    deadline = time.monotonic() + PATIENCE
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
        if error.errno != errno.ENOSPC:
            raise RegionUnusable(f"{path}: {error.strerror}") from None
        raise RegionUnusable(f"{path}: no room for {size} bytes; see `df /dev/shm` (docker: `--shm-size`)") from None


def _complete_header(fd: int, map: mmap.mmap, ours: h.Header) -> None:
    """Whoever finds no magic writes the header, magic last; the record lock lets one Python do it at a time.

    A PLC may do it at the same time, of another layout: whoever has written looks again before anything is used.
    """
    deadline = time.monotonic() + PATIENCE
    try:
        while not lock_byte(fd, REPAIR_LOCK) and time.monotonic() < deadline:
            time.sleep(0.001)
        if _peek(fd).magic == 0:
            data = h.pack(ours)
            magic, *others = h.MADE
            for place in others:
                map[place] = data[place]
            fence()
            with memoryview(map) as view, view[magic].cast("I") as word:
                word[0] = h.MAGIC
            time.sleep(_OTHER_MAKER)
    finally:
        unlock_byte(fd, REPAIR_LOCK)


def _check(topic: str, ours: h.Header, file: io.FileIO) -> None:
    theirs = _peek(file.fileno())
    if theirs.foreign:
        raise foreign(region_file(region_name(topic)), theirs)
    if _is_rounded(ours.size, theirs.size, file):
        theirs = theirs._replace(size=ours.size)
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


def _is_rounded(ours: int, theirs: int, file: io.FileIO) -> bool:
    """Whether a runtime has rounded the size up to larger pages, with nothing in the rest."""
    if theirs == ours or all(theirs != -(-ours // page) * page for page in _LARGER_PAGES):
        return False
    return not any(os.pread(file.fileno(), theirs - ours, ours))


def _peek(fd: int) -> h.Header:
    return h.unpack(os.pread(fd, h.HEADER_SIZE, 0), os.fstat(fd).st_size)
