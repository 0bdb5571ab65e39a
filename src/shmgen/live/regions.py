"""List the regions in /dev/shm, and read their headers."""

from __future__ import annotations

import os
import struct
from collections.abc import Sized
from contextlib import suppress

from shmgen.core import abi
from shmgen.core.diagnostics import closest
from shmgen.core.plural import counted
from shmgen.runtime import region_name
from shmgen.runtime.errors import RegionMissing, RegionUnusable, ShmError
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import opened
from shmgen.runtime.region.checks import not_a_region_error, opened_to_read
from shmgen.runtime.region.names import HALVES, region_file, semaphore_file
from shmgen.runtime.region.record_locks import READER_LOCK, WRITER_LOCK, byte_is_locked, holder

FOLDER = "/dev/shm"

_SLOT = struct.Struct("<QI")


class View:
    """A region that a tool inspects: opened read-only and never locked, so that the tool does not disturb its users."""

    __slots__ = ("_file", "name")

    def __init__(self, name: str) -> None:
        """Open the file of a region, such as `robot.pose`. The file may have no header yet.

        Raises RegionMissing, PermissionDenied, and RegionUnusable if the file is not a region.
        """
        self.name = name
        self._file = opened_to_read(name)
        header = self.header()
        if header.foreign:
            self.close()
            raise not_a_region_error(region_file(name), header)

    def header(self) -> h.Header:
        """Return the present header of the region. If the file is shorter than a header, the missing bytes are 0."""
        return h.unpack(os.pread(self._file.fileno(), h.HEADER_SIZE, 0), self.status.st_size)

    def stamp(self, number: int, header: h.Header) -> int | None:
        """Return the time at which sample `number` was written, in ns since 1970.

        Return 0 if the writer stored no time, and None if the sample was overwritten.
        """
        slot = self.slot(number, header)
        return _SLOT.unpack(self.read(slot, _SLOT.size))[0] if slot else None

    def slot(self, number: int, header: h.Header) -> int:
        """Return the offset in bytes of the slot with sample `number`, or 0 if the sample was overwritten."""
        for lane in range(abi.LANES):
            slot = h.HEADER_SIZE + (number % header.slots + lane * header.slots) * header.slot_size
            if _SLOT.unpack(self.read(slot, _SLOT.size).ljust(_SLOT.size, b"\0"))[1] == number:
                return slot
        return 0

    def read(self, start: int, size: int) -> bytes:
        """Return `size` bytes of the file from byte `start` on, or fewer if the file ends before."""
        return os.pread(self._file.fileno(), size, start)

    def claimed(self) -> bool:
        """Return True if a process holds the record lock of the writer. A PLC that writes holds no such lock."""
        return byte_is_locked(self._file.fileno(), WRITER_LOCK)

    def is_read(self) -> bool:
        """Return True if a process holds the record lock of a reader. A PLC that reads holds no such lock."""
        return byte_is_locked(self._file.fileno(), READER_LOCK)

    def writer(self, recorded: int) -> int:
        """Return the id of the process that holds the writer's record lock.

        Return `recorded`, the id in the header, if the process cannot be determined.
        """
        return holder(self._file.fileno(), WRITER_LOCK, recorded) or recorded

    @property
    def status(self) -> os.stat_result:
        """The owner, mode and size of the file."""
        return os.fstat(self._file.fileno())

    @property
    def removed(self) -> bool:
        """True if the file was removed from /dev/shm. A process with the removed file open gets no new samples."""
        return self.status.st_nlink == 0

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> View:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def live() -> list[str]:
    """List the names of all regions. A region is recognized by the magic number in its header."""
    return [name for name in _files() if is_region(name)]


def closed() -> list[str]:
    """List the names of probable regions that this user may not read: unreadable files with a region's semaphore."""
    with_semaphore = [name for name in _files() if os.path.lexists(semaphore_file(name))]
    return [name for name in with_semaphore if is_denied(region_file(name), os.O_RDONLY)]


def is_denied(file: str, how: int) -> bool:
    """Return True if the file is a regular file that this user may not open. Return False if the file does not exist.

    `how` is the access mode, such as os.O_RDONLY.
    """
    try:
        with suppress(FileNotFoundError, RegionUnusable), opened(file, how):
            pass
    except PermissionError:
        return os.path.isfile(file)
    return False


def unlisted(listed: Sized) -> str:
    """Return a note to print below the list of regions `listed`, or `""` if no note is necessary.

    The note counts the regions that this user may not read, or reports that there are no regions.
    """
    if not os.access(FOLDER, os.R_OK | os.X_OK):
        return f"this user may not list {FOLDER}; `shmgen doctor` shows how to fix this"
    if hidden := len(closed()):
        return f"this user may not read {counted(hidden, 'region')}; `shmgen doctor` shows how to fix this"
    return "" if listed else "no regions; each publisher and subscriber creates one, for example `shmgen pub`"


def is_region(name: str) -> bool:
    with suppress(ShmError, OSError), View(name) as view:
        return view.header().magic == h.MAGIC
    return False


def topic_of(name: str) -> str:
    """Return the topic of a region: `robot.pose` -> `/robot/pose`."""
    return "/" + name.replace(".", "/")


def resolve_topic(topic: str) -> list[str]:
    """Return the existing topics for a name: this topic, or the topics of the service or action with this name.

    If none exists, return `[topic]`.
    """
    halves = [] if "-" in topic or _exists(topic) else [f"{topic}-{half}" for half in HALVES]
    return [half for half in halves if _exists(half)] or [topic]


def missing(topic: str) -> RegionMissing:
    """Return the error for a topic without a region. The error lists all regions and suggests a similar topic."""
    topics = [topic_of(name) for name in (*live(), *closed())]
    close = closest("/" + topic.removeprefix("/"), topics, 0.75)
    there = f"existing: {', '.join(topics[:20])}{', ...' if len(topics) > 20 else ''}" if topics else "there are none"
    advice = f"did you mean {close}?" if close else "start a publisher or a subscriber: it creates the region"
    return RegionMissing(f"{topic}: no such region; {there}\n  hint: {advice}")


def damage(header: h.Header) -> str:
    """Return the first fault in a header, or `""` if the header is valid. Do not use the values of a damaged header."""
    if header.magic == 0:
        return "its header is not complete yet"
    if (header.abi, header.header_size) != (h.ABI, h.HEADER_SIZE):
        return f"another version of shmgen created it: ABI {header.abi}, here {h.ABI}"
    if header.slots < 2 or header.slots & header.slots - 1:
        return f"the number of slots is {header.slots}, which is not a power of two above 1"
    if header.slot_size < h.SLOT_HEADER + header.payload_size:
        return f"its slots have {header.slot_size} bytes, too few for {header.payload_size} + {h.SLOT_HEADER}"
    size = h.HEADER_SIZE + abi.LANES * header.slots * header.slot_size
    if header.size < size:
        needs = f"but its {abi.LANES} x {header.slots} slots of {header.slot_size} bytes need {size:,}"
        return f"the file has {counted(header.size, 'byte')}, {needs}"
    return ""


def sound(view: View) -> h.Header:
    """Return the header of a region. Raises RegionUnusable if the header is damaged or incomplete."""
    header = view.header()
    if why := damage(header):
        topic = topic_of(view.name)
        raise RegionUnusable(f"{topic}: the region is damaged: {why}; see `shmgen doctor {topic}`")
    return header


def depth_of(header: h.Header) -> int:
    """Return the depth with which to open a region, so that its number of slots is that of `header`."""
    return max(1, header.slots - 1)


def _exists(topic: str) -> bool:
    """Return True if the region of the topic or its semaphore exists. Raises ValueError for an invalid topic."""
    name = region_name(topic)
    return os.path.lexists(region_file(name)) or os.path.lexists(semaphore_file(name))


def is_name(name: str) -> bool:
    """Return True if a topic can have a region of this name. Other programs also create files in /dev/shm."""
    with suppress(ValueError):
        return region_name(topic_of(name)) == name
    return False


def _files() -> list[str]:
    """List the files in /dev/shm whose names are possible names of regions."""
    try:
        listed = sorted(os.listdir(FOLDER))
    except OSError:
        return []
    return [name for name in listed if is_name(name)]
