"""Check the files of a region, and return errors for unusable files."""

from __future__ import annotations

import errno
import io
import os
import struct
import sys
from typing import NoReturn

from shmgen.core import abi
from shmgen.runtime.errors import LayoutMismatch, RegionInUse, RegionMissing, RegionUnusable
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import denied, opened
from shmgen.runtime.region.names import region_file, region_name
from shmgen.runtime.region.record_locks import READER_LOCK, WRITER_LOCK, byte_is_locked, describe_writer, lock_byte

_LARGER_PAGES = (16384, 65536)
"""Page sizes in bytes above the usual 4096: of a Raspberry Pi 5 and Apple computers, and of ARM and POWER servers."""
_SIZES = (16, 32)
"""Bytes of sem_t in 32-bit and 64-bit processes, with glibc and with musl."""
_OURS = 32 if sys.maxsize > 2**32 else 16
_SHARING = struct.Struct("@8xI") if sys.maxsize > 2**32 else struct.Struct("@4xI")
_SHARED = (0, 128)
"""The values of `shared` in a semaphore of musl and of glibc (nptl/sem_open.c: FUTEX_SHARED)."""


def read_header(name: str) -> h.Header:
    """Return the header of the region `name`, such as `robot.pose`, whatever its message type is.

    `magic` shows whether shmgen created the file. Raises RegionMissing, PermissionDenied and RegionUnusable.
    """
    with opened_to_read(name) as file:
        return read_header_of(file.fileno())


def opened_to_read(name: str) -> io.FileIO:
    """Open the file of the region `name` for reading. Raises the same errors as read_header()."""
    path = region_file(name)
    try:
        return opened(path, os.O_RDONLY)
    except FileNotFoundError:
        raise RegionMissing(f"{path} does not exist: start a publisher or a subscriber of this topic") from None
    except PermissionError:
        raise denied(path) from None


def read_header_of(fd: int) -> h.Header:
    """Return the header in an open file."""
    return h.unpack(os.pread(fd, h.HEADER_SIZE, 0), os.fstat(fd).st_size)


def not_a_region_error(path: str, header: h.Header) -> RegionUnusable:
    """Return the error for a file that another program has created."""
    hint = f"`ls -l {path}` shows the owner; remove the file, or use another topic"
    return RegionUnusable(f"{path} is {header}\n  hint: {hint}")


def is_outdated(ours: h.Header, file: io.FileIO) -> bool:
    """Return True if the file is a region of shmgen that is retired or has another layout than `ours`.

    A retired region was replaced or removed, and carries a mark in its header.
    """
    theirs = read_header_of(file.fileno())
    return _is_of_this_abi(theirs) and (bool(theirs.retired) or not _fits(ours, theirs, file))


def check_header(topic: str, ours: h.Header, file: io.FileIO) -> None:
    """Check that an open file is the region of the topic, or is still empty.

    Raises LayoutMismatch if the region has another layout, and RegionUnusable if another program created the file.
    """
    name = region_name(topic)
    theirs = read_header_of(file.fileno())
    if theirs.foreign:
        raise not_a_region_error(region_file(name), theirs)
    if _fits(ours, theirs, file):
        return
    if theirs.digest == ours.digest and theirs.slots != ours.slots:
        advice = "the depth differs: configure the same depth on both sides"
    else:
        advice = "generate both sides from the same definitions and options"
    if not _is_of_this_abi(theirs):
        advice += f"; if the region is a leftover, remove it: `shmgen clean {topic}`"
    elif byte_is_locked(file.fileno(), WRITER_LOCK) or theirs.writer == h.PLC:
        advice += f"; {describe_writer(file.fileno(), theirs.writer)} writes the region: update or stop it"
    elif byte_is_locked(file.fileno(), READER_LOCK):
        advice += "; other subscribers use the region: stop these subscribers, or start the publisher"
    raise LayoutMismatch(
        f"{topic}: {region_file(name)} has another layout\n  region: {theirs}\n  here:   {ours}\n  {advice}"
    )


def check_semaphore(file: int, path: str) -> None:
    """Raise RegionUnusable if a file is not a usable semaphore. The C library does not check this.

    If the file has fewer bytes than a sem_t, the process would die of SIGBUS. A sem_t has a field for "private to a
    process" or "shared"; if its value is invalid, sem_post() would abort. A semaphore of a 32-bit process would look
    held or free forever to a 64-bit process, and vice versa.
    """
    data = os.pread(file, max(_SIZES) + 1, 0)
    if len(data) in _SIZES and len(data) != _OURS:
        raise RegionUnusable(
            f"{path} is a semaphore of a {2 * len(data)}-bit program, which this {2 * _OURS}-bit program cannot use: "
            "remove it with `shmgen clean`; if both programs must run, also write "
            'sync = "sequence" under [regions] in shmgen.toml, and generate both sides again'
        )
    if len(data) != _OURS or _SHARING.unpack_from(data)[0] not in _SHARED:
        raise RegionUnusable(f"{path} is not a semaphore of this machine's C library: remove it and start again")


def need_glibc(topic: str) -> None:
    """Raise RegionUnusable if the C library is not glibc, whose semaphores the lock of a region needs.

    musl stores its semaphores under the names of regions.
    """
    try:
        os.confstr("CS_GNU_LIBC_VERSION")
    except (OSError, ValueError):
        raise RegionUnusable(
            f"{topic}: the lock needs semaphores of glibc, which musl (Alpine) does not have: use an image with glibc, "
            'such as Debian, or write sync = "sequence" under [regions] in shmgen.toml, and generate both sides again'
        ) from None


def file_vanishes_error(path: str) -> RegionUnusable:
    """Return the error for a file that another program keeps removing."""
    return RegionUnusable(f"{path}: another program keeps removing this file: stop that program, and start again")


def raise_system_error(path: str, number: int, size: int) -> NoReturn:
    """Raise RegionUnusable for an errno that a system call returned for a region of `size` bytes."""
    if number == errno.ENOSPC:
        raise RegionUnusable(f"{path}: no space for {size} bytes; see `df /dev/shm` (docker: `--shm-size`)")
    raise RegionUnusable(f"{path}: {os.strerror(number)}; see `ulimit -a` and `df /dev/shm`")


def leads_to(path: str, file: int) -> bool:
    """Return True if a path leads to the file of this descriptor."""
    try:
        return os.path.samestat(os.fstat(file), os.lstat(path))
    except OSError:
        return False


def retire(path: str, file: int) -> bool:
    """Mark a region as retired and remove its name. Return False if another process is retiring the region.

    Publishers and subscribers that find the mark leave the region. PLCs find the mark as well; they have the region
    open without a record lock.
    """
    if not lock_byte(file, abi.REPAIR_LOCK):  # one process at a time: the next one sees that the name leads elsewhere
        return False
    os.pwrite(file, b"\1", 4 * h.RETIRED)
    if leads_to(path, file):
        os.unlink(path)
    return True


def log_replaced(topic: str, word: str, is_depth: bool) -> None:
    """Log that a publisher or subscriber (`word`) has replaced a region of another layout, or depth if `is_depth`."""
    import logging  # takes longer to load than the rest of the runtime

    cause, advice = "layout", "Generate both sides from the same definitions and options."
    if is_depth:
        cause, advice = "depth", "Configure the same depth on both sides."
    logging.getLogger("shmgen").warning(
        f"{topic}: this {word} replaced an unused region of another {cause}, {region_file(region_name(topic))}, "
        f"and its samples are lost. {advice}"
    )


def region_in_use_error(topic: str, who: str) -> RegionInUse:
    """Return the error for a second writer of a topic. `who` is the text for the first writer."""
    return RegionInUse(f"{topic}: {who} publishes already: stop it first, because a topic has only one publisher")


def _is_of_this_abi(header: h.Header) -> bool:
    return (header.magic, header.abi, header.header_size) == (h.MAGIC, h.ABI, h.HEADER_SIZE)


def _fits(ours: h.Header, theirs: h.Header, file: io.FileIO) -> bool:
    if _is_rounded(ours.size, theirs.size, file):
        theirs = theirs._replace(size=ours.size)
    return theirs.fixed == ours.fixed or (theirs.magic == 0 and theirs.size == ours.size)


def _is_rounded(ours: int, theirs: int, file: io.FileIO) -> bool:
    """Return True if a region is larger than `ours` bytes only because its creator's machine has larger pages.

    `theirs` is the size of the region in bytes. All bytes after `ours` must be 0.
    """
    if theirs == ours or all(theirs != -(-ours // page) * page for page in _LARGER_PAGES):
        return False
    return not any(os.pread(file.fileno(), theirs - ours, ours))
