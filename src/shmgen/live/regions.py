"""Which regions are in /dev/shm, and what their headers say now."""

from __future__ import annotations

import os
import struct
from collections.abc import Sized
from contextlib import suppress
from types import TracebackType
from typing import Any

from shmgen.core import abi
from shmgen.core.diagnostics import closest
from shmgen.core.plural import counted
from shmgen.runtime import region_name
from shmgen.runtime.errors import RegionMissing, RegionUnusable, ShmError
from shmgen.runtime.region import header as h
from shmgen.runtime.region.holders import holder
from shmgen.runtime.region.looks import READER_LOCK, WRITER_LOCK, byte_is_locked, foreign, opened_to_read
from shmgen.runtime.region.names import HALVES, region_file, semaphore_file

FOLDER = "/dev/shm"

_SLOT = struct.Struct("<QI")


class View:
    """A region as a bystander sees it: opened read-only, never locked, so that nobody is disturbed."""

    __slots__ = ("_file", "name")

    def __init__(self, name: str) -> None:
        """Opens the file of the region `name`: `robot.pose`. Raises RegionMissing, PermissionDenied, RegionUnusable.

        It may have no header yet; what something else has made is not opened.
        """
        self.name = name
        self._file = opened_to_read(name)
        header = self.header()
        if header.foreign:
            self.close()
            raise foreign(region_file(name), header)

    def header(self) -> h.Header:
        """As it is now; a file shorter than a header is read as if zeros followed."""
        return h.unpack(os.pread(self._file.fileno(), h.HEADER_SIZE, 0), self.status.st_size)

    def stamp(self, number: int, header: h.Header) -> int | None:
        """Nanoseconds since 1970 when sample `number` was written, 0 if its writer has no clock; None: overwritten."""
        slot = self.slot(number, header)
        return _SLOT.unpack(self.read(slot, _SLOT.size))[0] if slot else None

    def slot(self, number: int, header: h.Header) -> int:
        """Where sample `number` lies whole, 0 = nowhere: overwritten."""
        for lane in range(abi.LANES):
            slot = h.HEADER_SIZE + (number % header.slots + lane * header.slots) * header.slot_size
            if _SLOT.unpack(self.read(slot, _SLOT.size).ljust(_SLOT.size, b"\0"))[1] == number:
                return slot
        return 0

    def read(self, start: int, size: int) -> bytes:
        """Bytes of the file, fewer at its end."""
        return os.pread(self._file.fileno(), size, start)

    def claimed(self) -> bool:
        """Whether a living process holds the record lock of the writer; PLCs take none."""
        return byte_is_locked(self._file.fileno(), WRITER_LOCK)

    def is_read(self) -> bool:
        """Whether a living process holds that of a reader."""
        return byte_is_locked(self._file.fileno(), READER_LOCK)

    def writer(self, said: int) -> int:
        """The process that holds it; `said`, what stands in the header, where this user cannot see."""
        return holder(self._file.fileno(), WRITER_LOCK, said) or said

    @property
    def status(self) -> os.stat_result:
        """Owner, mode, size."""
        return os.fstat(self._file.fileno())

    @property
    def removed(self) -> bool:
        """The file is gone from /dev/shm; whoever has it open sees nothing new."""
        return self.status.st_nlink == 0

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> View:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def removed(end: Any) -> bool:
    """Whether a region of a publisher, subscriber, client or server of ours is gone from /dev/shm."""
    calls = getattr(end, "_calls", None)
    ends = (calls._requests, calls._responses, getattr(end, "_progress", calls._requests)) if calls else (end,)
    return any(one._end.is_removed() for one in ends)


def live() -> list[str]:
    """The names of all regions, known by their magic."""
    return [name for name in _files() if is_region(name)]


def closed() -> list[str]:
    """Names of what may be regions but cannot be read by this user: files with a semaphore beside them."""
    files = {name: region_file(name) for name in _files() if os.path.lexists(semaphore_file(name))}
    regular = {name: file for name, file in files.items() if os.path.isfile(file) and not os.path.islink(file)}
    return [name for name, file in regular.items() if not os.access(file, os.R_OK)]


def unlisted(listed: Sized) -> str:
    """What to say beside a list of all regions: that some cannot be read by this user, or why there are none."""
    if hidden := len(closed()):
        return f"{counted(hidden, 'region')} that this user may not read; `shmgen doctor` says which group to join"
    return "" if listed else "no regions; `shmgen pub` makes one, and so does every publisher and subscriber"


def is_region(name: str) -> bool:
    with suppress(ShmError, OSError), View(name) as view:
        return view.header().magic == h.MAGIC
    return False


def topic_of(name: str) -> str:
    """`robot.pose` -> `/robot/pose`."""
    return "/" + name.replace(".", "/")


def meant(topic: str) -> list[str]:
    """The topic itself, or if nothing is called so the halves that there are of a service or action of that name."""
    halves = [] if "-" in topic or _exists(topic) else [f"{topic}-{half}" for half in HALVES]
    return [half for half in halves if _exists(half)] or [topic]


def missing(topic: str) -> RegionMissing:
    """What to say of a topic that has no region: which regions there are, and which of them may be meant."""
    topics = [topic_of(name) for name in (*live(), *closed())]
    close = closest("/" + topic.removeprefix("/"), topics, 0.75)
    there = f"there are {', '.join(topics[:20])}{', ...' if len(topics) > 20 else ''}" if topics else "there are none"
    advice = f"did you mean {close}?" if close else "a region comes with its first publisher or subscriber"
    return RegionMissing(f"{topic}: no such region; {there}\n  hint: {advice}")


def damage(header: h.Header) -> str:
    """What in a header cannot be, or nothing: no number of a damaged one may be counted with."""
    if header.magic == 0:
        return "nobody has completed its header yet"
    if (header.abi, header.header_size) != (h.ABI, h.HEADER_SIZE):
        return f"it was made by another version of shmgen: ABI {header.abi}, here {h.ABI}"
    if header.slots < 2 or header.slots & header.slots - 1:
        return f"it says {header.slots} slots, and that is no power of two above 1"
    if header.slot_size < h.SLOT_HEADER + header.payload_size:
        return f"its slots of {header.slot_size} bytes cannot hold {header.payload_size} and {h.SLOT_HEADER}"
    size = h.HEADER_SIZE + abi.LANES * header.slots * header.slot_size
    if header.size < size:
        needs = f"its {abi.LANES} x {header.slots} slots of {header.slot_size} need {size:,}"
        return f"the file has {counted(header.size, 'byte')}, {needs}"
    return ""


def sound(view: View) -> h.Header:
    """The header as it is now. Raises RegionUnusable for a damaged one."""
    header = view.header()
    if why := damage(header):
        topic = topic_of(view.name)
        raise RegionUnusable(f"{topic}: the region is damaged: {why}; see `shmgen doctor {topic}`")
    return header


def depth_of(header: h.Header) -> int:
    """A depth that gives as many slots."""
    return max(1, header.slots - 1)


def _exists(topic: str) -> bool:
    """A region, or what is left of one. Raises ValueError for a wrong name."""
    name = region_name(topic)
    return os.path.lexists(region_file(name)) or os.path.lexists(semaphore_file(name))


def _files() -> list[str]:
    """Names in /dev/shm that a topic can have."""
    try:
        found = sorted(os.listdir(FOLDER))
    except OSError:
        return []
    names = []
    for name in found:
        with suppress(ValueError):
            if region_name(topic_of(name)) == name:
                names.append(name)
    return names
