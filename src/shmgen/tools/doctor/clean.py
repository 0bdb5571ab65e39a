"""Which files of a topic to remove, or why not to."""

from __future__ import annotations

import os
import time
from contextlib import suppress

from shmgen.live.processes import Processes, called
from shmgen.live.regions import FOLDER, View, missing
from shmgen.runtime import region_name
from shmgen.runtime.errors import PermissionDenied, RegionMissing
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import opened
from shmgen.runtime.region.looks import foreign, peek, retire
from shmgen.runtime.region.names import event_name, region_file, semaphore_file

_WATCH = 0.25
"""Seconds within which a PLC that runs counts its heartbeat up, also with a slow task."""


def leftovers(topic: str) -> list[str]:
    """The files of a topic, the region last: who is killed while removing them leaves what is known by its magic.

    A region whose maker died before it wrote the header counts, and semaphores without a region. Raises
    RegionMissing, PermissionDenied, and RegionUnusable for a file that is none of ours.
    """
    name = region_name(topic)
    files = [file for file in (semaphore_file(event_name(name)), semaphore_file(name)) if os.path.lexists(file)]
    try:
        with View(name) as view:
            header = view.header()
    except RegionMissing:
        if not files:
            raise missing(topic) from None
        return files
    if header.magic != h.MAGIC and not _unfinished(header):
        raise foreign(region_file(name), header)
    return [*files, region_file(name)]


def in_use(topic: str, processes: Processes) -> str:
    """Who needs the files: a living writer, or a process that has them mapped. Nothing if nobody does."""
    name, hidden = region_name(topic), ""
    try:
        with View(name) as view:
            header = view.header()
            if view.is_read():
                hidden = "a process of another user or in another container has it open"
            if view.claimed():
                writer = view.writer(header.writer)
                return f"process {writer} {_named(writer)}publishes on it"
            if header.writer == h.PLC and _beats(view, header.heartbeat):
                return "a PLC publishes on it"
    except RegionMissing:
        pass
    device = os.stat(FOLDER).st_dev
    names = {name, f"sem.{name}", f"sem.{event_name(name)}"}
    pids = sorted(
        {
            mapping.pid
            for mapping in processes.mappings
            if mapping.name in names and mapping.device == device and not mapping.removed
        }
    )
    return ", ".join(f"process {pid} {_named(pid)}has it open" for pid in pids) or hidden


def remove(files: list[str]) -> None:
    """Tells those who have the region open, as PLCs that read it may. Raises PermissionDenied."""
    for file in files:
        try:
            if not _retired(file):
                os.unlink(file)
        except FileNotFoundError:
            continue
        except PermissionError:
            owner = os.lstat(file).st_uid
            raise PermissionDenied(
                f"{file} belongs to user {owner}, and in sticky {FOLDER} only the owner and root may remove it: "
                "run this with sudo"
            ) from None


def _retired(file: str) -> bool:
    """Whether it was a region, whose name is gone now: who was told may have made a new one under it already."""
    with suppress(PermissionError), opened(file, os.O_RDWR) as region:
        return peek(region.fileno()).magic == h.MAGIC and retire(file, region.fileno())
    return False


def _unfinished(header: h.Header) -> bool:
    """Empty, all zeros, or our header but for the magic, which comes last."""
    return header.magic == 0 and (header.header_size == h.HEADER_SIZE or not any(header[1:]))


def _named(pid: int) -> str:
    name = called(pid)
    return f"({name}) " if name else ""


def _beats(view: View, before: int) -> bool:
    deadline = time.monotonic() + _WATCH
    while time.monotonic() < deadline:
        if view.header().heartbeat != before:
            return True
        time.sleep(0.005)
    return False
