"""Looks at the files of a region: its header, or what to say of files that are none."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import struct
import sys
from typing import NoReturn

from shmgen.core import abi
from shmgen.runtime.errors import LayoutMismatch, RegionInUse, RegionMissing, RegionUnusable
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import denied, opened
from shmgen.runtime.region.holders import holder
from shmgen.runtime.region.names import region_file, region_name

WRITER_LOCK = abi.WRITER_LOCK
"""The byte under a record lock as long as somebody publishes."""
READER_LOCK = abi.READER_LOCK
"""The same of readers, who share it."""
_LARGER_PAGES = (16384, 65536)
"""Bytes: on a Raspberry Pi 5 and Apple's machines, and in kernels for servers with ARM or POWER."""
_FLOCK = struct.Struct("hhqqi4x")
_SIZES = (16, 32)
"""Bytes of sem_t in 32-bit and 64-bit processes, with glibc and with musl."""
_OURS = 32 if sys.maxsize > 2**32 else 16
_SHARING = struct.Struct("@8xI") if sys.maxsize > 2**32 else struct.Struct("@4xI")
_SHARED = (0, 128)
"""What says `shared` in musl and in glibc (nptl/sem_open.c: FUTEX_SHARED)."""


def read_header(name: str) -> h.Header:
    """The header of the region `name` (`robot.pose`), whatever its type; `magic` shows whether it is one of shmgen's.

    Raises RegionMissing, PermissionDenied and RegionUnusable.
    """
    with opened_to_read(name) as file:
        return peek(file.fileno())


def opened_to_read(name: str) -> io.FileIO:
    """The file of the region `name`. Raises as read_header()."""
    path = region_file(name)
    try:
        return opened(path, os.O_RDONLY)
    except FileNotFoundError:
        raise RegionMissing(f"{path} does not exist: start a publisher or a subscriber of it") from None
    except PermissionError:
        raise denied(path) from None


def peek(fd: int) -> h.Header:
    """The header in an open file."""
    return h.unpack(os.pread(fd, h.HEADER_SIZE, 0), os.fstat(fd).st_size)


def foreign(path: str, header: h.Header) -> RegionUnusable:
    """What to say of a file that something else has made."""
    hint = f"`ls -l {path}` shows whose it is; remove it, or use another topic"
    return RegionUnusable(f"{path} is {header}\n  hint: {hint}")


def is_outdated(ours: h.Header, file: io.FileIO) -> bool:
    """Whether a region of shmgen has another layout, or was retired."""
    theirs = peek(file.fileno())
    return _is_of_this_abi(theirs) and (bool(theirs.retired) or not _fits(ours, theirs, file))


def check_header(topic: str, ours: h.Header, file: io.FileIO) -> None:
    """Raises LayoutMismatch and RegionUnusable unless that is the topic's region, or still empty."""
    name = region_name(topic)
    theirs = peek(file.fileno())
    if theirs.foreign:
        raise foreign(region_file(name), theirs)
    if _fits(ours, theirs, file):
        return
    if theirs.digest == ours.digest and theirs.slots != ours.slots:
        advice = "the depth differs: configure the same depth on both sides"
    else:
        advice = "generate both sides from the same definitions and options"
    if not _is_of_this_abi(theirs):
        advice += f"; if the region is a leftover, remove it: `shmgen clean {topic}`"
    elif byte_is_locked(file.fileno(), WRITER_LOCK) or theirs.writer == h.PLC:
        advice += f"; {writer_of(topic, file.fileno(), theirs.writer)} writes it: update that side, or stop it"
    elif byte_is_locked(file.fileno(), READER_LOCK):
        advice += "; others read it, and a reader does not replace it: stop them, or start the publisher"
    raise LayoutMismatch(
        f"{topic}: {region_file(name)} holds another layout\n  there: {theirs}\n  here:  {ours}\n  {advice}"
    )


def check_semaphore(file: int, path: str) -> None:
    """Raises RegionUnusable for a file that is no semaphore: the C library believes what lies there.

    It maps as many bytes as its sem_t has, so that a process dies of SIGBUS where there are none, and aborts at a
    post where the word that says private or shared is neither. That of a program of other bitness it takes for held,
    or for free, for ever.
    """
    data = os.pread(file, max(_SIZES) + 1, 0)
    if len(data) in _SIZES and len(data) != _OURS:
        raise RegionUnusable(
            f"{path} was made by a program of {2 * len(data)} bits, this is one of {2 * _OURS}, and no semaphore "
            'crosses that: write sync = "sequence" under [regions] in shmgen.toml, generate both sides again, and '
            "remove it; or remove it, if it is a leftover: `shmgen clean`"
        )
    if len(data) != _OURS or _SHARING.unpack_from(data)[0] not in _SHARED:
        raise RegionUnusable(f"{path} is not a semaphore of this machine's C library: remove it and start again")


def need_glibc(topic: str) -> None:
    """Raises RegionUnusable under any other C library: musl has its semaphores under the names of regions."""
    try:
        os.confstr("CS_GNU_LIBC_VERSION")
    except (OSError, ValueError):
        raise RegionUnusable(
            f"{topic}: a lock takes glibc's semaphores, which musl (Alpine) does not have: run this in an image with "
            'glibc, as Debian\'s, or write sync = "sequence" into shmgen.toml and generate both sides again'
        ) from None


def restless(path: str) -> RegionUnusable:
    """What to say of a file that is never the same twice."""
    return RegionUnusable(f"{path} keeps appearing and vanishing: something removes it; stop that and start again")


def refused_by_system(path: str, number: int, size: int) -> NoReturn:
    """Raises what an errno means for a region of so many bytes."""
    if number == errno.ENOSPC:
        raise RegionUnusable(f"{path}: no room for {size} bytes; see `df /dev/shm` (docker: `--shm-size`)")
    raise RegionUnusable(f"{path}: {os.strerror(number)}; see `ulimit -a` and `df /dev/shm`")


def writer_of(topic: str, file: int, said: int) -> str:
    """Who writes, for people: `said` is the word `writer` of the region behind descriptor `file`."""
    if byte_is_locked(file, WRITER_LOCK):
        pid = holder(file, WRITER_LOCK, said)
        return f"process {pid}" if pid else f"process {said} of another user or container"
    return "a PLC" if said == h.PLC else f"process {said}"


def leads_to(path: str, file: int) -> bool:
    """Whether that path is the one of that descriptor."""
    try:
        return os.path.samestat(os.fstat(file), os.lstat(path))
    except OSError:
        return False


def retire(path: str, file: int) -> bool:
    """Takes the name away from a region, and tells all who have it open: PLCs take no record lock. False: not now."""
    if not lock_byte(file, abi.REPAIR_LOCK):  # one at a time: the next finds that the name leads elsewhere
        return False
    os.pwrite(file, b"\1", 4 * h.RETIRED)
    if leads_to(path, file):
        os.unlink(path)
    return True


def in_use(topic: str, who: str) -> RegionInUse:
    """What to say to a second writer."""
    return RegionInUse(f"{topic}: {who} publishes already; one writer a topic: stop that one first")


def lock_byte(fd: int, byte: int, kind: int = fcntl.F_WRLCK) -> bool:
    """Tries for a record lock of the open-file kind; it goes with the descriptor, also by SIGKILL."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(kind, os.SEEK_SET, byte, 1, 0))
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


def _is_of_this_abi(header: h.Header) -> bool:
    return (header.magic, header.abi, header.header_size) == (h.MAGIC, h.ABI, h.HEADER_SIZE)


def _fits(ours: h.Header, theirs: h.Header, file: io.FileIO) -> bool:
    if _is_rounded(ours.size, theirs.size, file):
        theirs = theirs._replace(size=ours.size)
    return theirs.fixed == ours.fixed or (theirs.magic == 0 and theirs.size == ours.size)


def _is_rounded(ours: int, theirs: int, file: io.FileIO) -> bool:
    """Whether a runtime has rounded the size up to larger pages, with nothing in the rest."""
    if theirs == ours or all(theirs != -(-ours // page) * page for page in _LARGER_PAGES):
        return False
    return not any(os.pread(file.fileno(), theirs - ours, ours))
