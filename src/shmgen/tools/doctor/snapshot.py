"""Takes down what `doctor` judges by: a region, its semaphore and the processes around it."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field

from shmgen.core.model import Regions
from shmgen.live.config_of_lock import Known
from shmgen.live.processes import Processes, bits, called
from shmgen.live.regions import FOLDER, View, topic_of
from shmgen.runtime import Header
from shmgen.runtime.errors import RegionUnusable, ShmError
from shmgen.runtime.region.access import opened
from shmgen.runtime.region.names import semaphore_file

_WATCH = 0.25
_WATCH_LOCK = 1.05
"""Seconds between the two looks; the second where a lock seems stuck: a PLC may hold it for a second and live."""

SIZES = (16, 32)
"""Bytes: sem_t of 32-bit and of 64-bit processes, with glibc and with musl."""
_WAITS = 1
"""Bits below the value in glibc's sem_t of 32-bit processes, which have no atomic word for value and waiters both."""


@dataclass(frozen=True, slots=True)
class Semaphore:
    """The file of a POSIX semaphore: its value, and the bitness of its maker.

    `value` is None where this user may not read it, and of what is no semaphore.
    """

    value: int | None
    bits: int
    status: os.stat_result


@dataclass(frozen=True, slots=True)
class Peer:
    """A process that maps the region; `bits` None if they cannot be seen."""

    pid: int
    name: str
    bits: int | None

    def __str__(self) -> str:
        return f"process {self.pid}" + (f" ({self.name})" if self.name else "")


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the folder's configuration says of a topic: None and nothing where it says nothing."""

    type: str = ""
    depth: int | None = None
    regions: Regions = field(default_factory=Regions)


@dataclass(frozen=True, slots=True)
class Evidence:
    """One region at two looks, `seconds` apart; `layout` is what its type looks like by the folder's configuration."""

    name: str
    status: os.stat_result
    before: Header
    after: Header
    semaphores: tuple[Semaphore | None, Semaphore | None]
    seconds: float
    claimed: bool
    """A process publishes: `writer`, by the record lock; else that is who has left its name there."""
    writer: int
    peers: tuple[Peer, ...]
    wanted: Wanted
    layout: Known | None

    @property
    def topic(self) -> str:
        return topic_of(self.name)


def gather(
    names: Sequence[str], processes: Processes, topics: Mapping[str, Wanted], layouts: Mapping[str, Known]
) -> list[Evidence]:
    """Looks at all regions twice. One that vanishes meanwhile, or cannot be read, is left out."""
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
                peers=_peers(view, processes),
                wanted=topics.get(topic_of(view.name), Wanted()),
                layout=layouts.get(header.type_name),
            )
            for view, (header, lock) in zip(views, first, strict=True)
            if not view.removed
        ]


def semaphore(name: str) -> Semaphore | None:
    """The semaphore's file, read as a file: to open it as a semaphore takes the right to write. None: there is none."""
    file = semaphore_file(name)
    value = None
    try:
        status = os.lstat(file)
        with suppress(PermissionError, RegionUnusable), opened(file, os.O_RDONLY) as found:
            status = os.fstat(found.fileno())
            word = int.from_bytes(found.read(4), "little")
            value = {SIZES[0]: word >> _WAITS, SIZES[1]: word}.get(status.st_size)
    except FileNotFoundError:
        return None
    return Semaphore(value, 32 if status.st_size == SIZES[0] else 64, status)


def own_device() -> int:
    """The number of this /dev/shm, as stat and /proc/PID/maps have it."""
    return os.stat(FOLDER).st_dev


def _seems_stuck(view: View, header: Header, before: Semaphore | None) -> bool:
    now = semaphore(view.name)
    taken = before is not None and before.value == 0 and now is not None and now.value == 0
    return taken and view.header().lock_count == header.lock_count


def _peers(view: View, processes: Processes) -> tuple[Peer, ...]:
    status = view.status
    pids = [m.pid for m in processes.mappings if (m.device, m.inode) == (status.st_dev, status.st_ino)]
    return tuple(Peer(pid, called(pid), bits(pid)) for pid in pids)
