"""Collects the evidence for `shmgen doctor`: each region, its semaphore and the processes that map it."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field

from shmgen.core.model import Regions
from shmgen.live.config_of_lock import Known
from shmgen.live.processes import Processes, bits, called
from shmgen.live.regions import View, topic_of
from shmgen.runtime import Header
from shmgen.runtime.errors import RegionUnusable, ShmError
from shmgen.runtime.region.access import opened
from shmgen.runtime.region.names import semaphore_file

_WATCH = 0.25
_WATCH_LOCK = 1.05
"""Seconds between two reads of a header, usually and if a lock seems stuck. A PLC may hold a lock for 1 s."""

SIZES = (16, 32)
"""Sizes in bytes of sem_t in 32-bit and in 64-bit processes, with glibc and with musl."""
_WAITS = 1
"""Number of bits below the value of the semaphore in the first word of a sem_t of 32-bit glibc.

This bit is set while processes wait. In 64-bit processes, the value has a 32-bit word of its own.
"""


@dataclass(frozen=True, slots=True)
class Semaphore:
    """The state of a semaphore, read from its file: its value, and the bitness of the process that created it.

    `value` is None if this user cannot read the file, or if the file is not a semaphore.
    """

    value: int | None
    bits: int
    status: os.stat_result


@dataclass(frozen=True, slots=True)
class Peer:
    """A process that maps the region. `bits` is 32 or 64, or None if this user cannot inspect the process."""

    pid: int
    name: str
    bits: int | None

    def __str__(self) -> str:
        return f"process {self.pid}" + (f" ({self.name})" if self.name else "")


@dataclass(frozen=True, slots=True)
class Expected:
    """The type, depth and permissions that the configuration gives a topic. An absent setting has its default here."""

    type: str = ""
    depth: int | None = None
    regions: Regions = field(default_factory=Regions)


@dataclass(frozen=True, slots=True)
class Evidence:
    """The state of a region in which `shmgen doctor` looks for problems: files, processes, and two headers.

    The header was read twice, `seconds` apart: first as `before`, then as `after`. `layout` is the layout that the
    configuration of the current folder gives the region's type.
    """

    name: str
    status: os.stat_result
    before: Header
    after: Header
    semaphores: tuple[Semaphore | None, Semaphore | None]
    seconds: float
    claimed: bool
    """True if the process `writer` publishes, by its record lock. Otherwise `writer` is the last recorded writer."""
    writer: int
    peers: tuple[Peer, ...]
    expected: Expected
    layout: Known | None

    @property
    def topic(self) -> str:
        return topic_of(self.name)


def gather(
    names: Sequence[str], processes: Processes, topics: Mapping[str, Expected], layouts: Mapping[str, Known]
) -> list[Evidence]:
    """Read the header of each region twice, and return the evidence about each region.

    `topics` contains the expected state by topic, and `layouts` the configured layout by type name. Skip regions that
    disappear meanwhile or that cannot be read.
    """
    with ExitStack() as stack:
        views: list[View] = []
        for name in names:
            with suppress(ShmError):
                views.append(stack.enter_context(View(name)))
        begun = time.monotonic()
        first = [(view.header(), semaphore(view.name)) for view in views]
        if views:
            time.sleep(_WATCH)
        if any(_seems_stuck(view, *look) for view, look in zip(views, first, strict=True)):
            time.sleep(_WATCH_LOCK - _WATCH)
        seconds = time.monotonic() - begun
        return [
            Evidence(
                name=view.name,
                status=view.status,
                before=header,
                after=(after := view.header()),
                semaphores=(lock, semaphore(view.name)),
                seconds=seconds,
                claimed=(claimed := view.claimed()),
                writer=view.writer(after.writer) if claimed else after.writer,
                peers=tuple(Peer(pid, called(pid), bits(pid)) for pid in processes.users(view.status)),
                expected=topics.get(topic_of(view.name), Expected()),
                layout=layouts.get(header.type_name),
            )
            for view, (header, lock) in zip(views, first, strict=True)
            if not view.removed
        ]


def semaphore(name: str) -> Semaphore | None:
    """Return the state of a region's semaphore, or None if there is none.

    Read the file directly, because sem_open() requires permission to write.
    """
    file = semaphore_file(name)
    value = None
    try:
        status = os.lstat(file)
        with suppress(PermissionError, RegionUnusable), opened(file, os.O_RDONLY) as opened_file:
            status = os.fstat(opened_file.fileno())
            word = int.from_bytes(opened_file.read(4), "little")
            value = {SIZES[0]: word >> _WAITS, SIZES[1]: word}.get(status.st_size)
    except FileNotFoundError:
        return None
    return Semaphore(value, 32 if status.st_size == SIZES[0] else 64, status)


def _seems_stuck(view: View, header: Header, before: Semaphore | None) -> bool:
    now = semaphore(view.name)
    is_held = before is not None and before.value == 0 and now is not None and now.value == 0
    return is_held and view.header().lock_count == header.lock_count
