"""What `ros2 topic list` and `info` say of topics, of all regions or one."""

from __future__ import annotations

import os
import time
from collections.abc import Collection
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

from shmgen.core.plural import counted
from shmgen.live import processes
from shmgen.live.processes import Processes, called
from shmgen.live.regions import FOLDER, View, damage, live, missing, topic_of
from shmgen.runtime import region_name
from shmgen.runtime.errors import RegionMissing, ShmError
from shmgen.runtime.region import header as h
from shmgen.runtime.region.names import region_file
from shmgen.tools.watch.top import age_of, aligned, cell, writer_of

_TRIES = 5
TITLES = ("TOPIC", "TYPE", "WRITER", "READERS", "SLOTS", "AGE")


@dataclass(frozen=True, slots=True)
class Region:
    """One topic. `readers` are the processes that have it open beside its writer, as far as this user may see.

    `age` is in seconds since its newest sample, None where that has no stamp; sizes in bytes. Of a damaged one `type`
    says what is wrong.
    """

    topic: str
    type: str
    writer: str
    readers: tuple[int, ...]
    slots: int
    age: float | None
    samples: int
    missed: int
    payload: int
    size: int
    digest: str

    def plain(self) -> dict[str, Any]:
        return asdict(self)


def look() -> list[Region]:
    """Every region there is."""
    around = processes.look()
    found = []
    for name in live():
        with suppress(ShmError, OSError), View(name) as view:
            found.append(_region(view, around))
    return found


def one(topic: str) -> tuple[Region, bool]:
    """One, and whether processes of others could not be looked into. Raises RegionMissing, PermissionDenied."""
    around = processes.look()
    with suppress(RegionMissing), View(region_name(topic)) as view:
        return _region(view, around), bool(around.hidden and os.geteuid())
    raise missing(topic)


def table(regions: Collection[Region], width: int | None) -> list[str]:
    """Aligned columns, the titles first."""
    rows = [TITLES, *(_cells(region) for region in regions)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(TITLES))]
    return aligned(rows, range(3), widths, width)


def text(region: Region, hidden: bool) -> str:
    """What `info` prints."""
    readers = [f"  {pid} {called(pid)}" for pid in region.readers]
    age = "" if region.age is None else f", the newest {age_of(region.age)} old"
    return "\n".join(
        [
            f"type: {region.type}",
            f"digest: 16#{region.digest.upper()}",
            f"file: {region_file(region_name(region.topic))}, {counted(region.size, 'byte')}",
            f"payload: {counted(region.payload, 'byte')}, {counted(region.slots, 'slot')}",
            f"samples: {region.samples:,}{age}; {region.missed:,} missed by readers",
            f"writer: {region.writer}",
            f"readers: {len(region.readers)}{'; others may be hidden: sudo sees them' if hidden else ''}",
            *readers,
        ]
    )


def _region(view: View, around: Processes) -> Region:
    header, status = view.header(), view.status
    topic, digest = topic_of(view.name), f"{header.digest:016x}"
    device = os.stat(FOLDER).st_dev
    pids = {found.pid for found in around.mappings if (found.device, found.inode) == (device, status.st_ino)} - {
        os.getpid()
    }
    if why := damage(header):
        return Region(topic, f"damaged: {why}", "-", tuple(sorted(pids)), 0, None, 0, 0, 0, header.size, digest)
    writer = view.writer(header.writer) if view.claimed() else None
    stamp = newest_stamp(view, header)
    return Region(
        topic=topic,
        type=header.type_name,
        writer=writer_of(view, header, None),
        readers=tuple(sorted(pids - {writer})),
        slots=header.slots,
        age=max(0.0, (time.time_ns() - stamp) / 1e9) if stamp else None,
        samples=header.newest,
        missed=header.missed,
        payload=header.payload_size,
        size=header.size,
        digest=digest,
    )


def newest_stamp(view: View, header: h.Header) -> int | None:
    """Of the newest sample; tried again where that was overwritten in between."""
    for _ in range(_TRIES):
        if not header.newest:
            return None
        stamp = view.stamp(header.newest, header)
        if stamp is not None:
            return stamp
        header = view.header()
    return None


def _cells(region: Region) -> tuple[str, ...]:
    numbers = str(len(region.readers)), str(region.slots), cell("age", region.age)
    return region.topic, region.type, region.writer, *numbers
