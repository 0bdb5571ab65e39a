"""Decides which files of a topic `shmgen clean` may remove, and removes them. Also finds abandoned temporary files."""

from __future__ import annotations

import os
import re
import time
from contextlib import suppress

from shmgen.live.processes import Processes, called, has_open
from shmgen.live.regions import FOLDER, View, missing
from shmgen.runtime import region_name
from shmgen.runtime.errors import PermissionDenied, RegionMissing
from shmgen.runtime.region import header as h
from shmgen.runtime.region.access import opened
from shmgen.runtime.region.checks import not_a_region_error, read_header_of, retire
from shmgen.runtime.region.names import event_name, region_file, semaphore_file
from shmgen.tools.doctor.snapshot import SIZES

_WATCH = 0.25
"""Seconds within which a running PLC increments its heartbeat, even if its task is slow."""

AGE = 3.0
"""Seconds after which a temporary file counts as abandoned. Creating a semaphore takes microseconds."""
_TEMPORARY = re.compile(r"sem\.[A-Za-z0-9]{6}")
"""Temporary name of a semaphore in glibc, which then links the file to its name (sem_open.c, mktemp)."""
_WORD = re.compile(r"sem\.([A-Za-z][a-z]*|[A-Z]+)[0-9]*")
"""Names that a user may have chosen, such as `sem.camera` or `sem.motor1`. One random name in forty matches too."""


def leftovers(topic: str) -> list[str]:
    """Return the files of a topic that `shmgen clean` should remove: its semaphores, then its region.

    The region is last: `shmgen clean --all` searches for regions, and can then repeat an interrupted removal. The list
    includes a region whose creator died before writing the header, and semaphores without a region. Raises
    RegionMissing if there are no files, PermissionDenied, and RegionUnusable if the region's file is not a region of
    shmgen.
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
    if header.magic != h.MAGIC and not _is_unfinished(header):
        raise not_a_region_error(region_file(name), header)
    return [*files, region_file(name)]


def in_use(topic: str, processes: Processes) -> str:
    """Return a phrase that names the living writer, or else the processes that have the files open.

    Return `""` if no process uses the topic.
    """
    name, hidden = region_name(topic), ""
    try:
        with View(name) as view:
            header = view.header()
            if view.is_read():
                hidden = "a process of another user or in another container uses it"
            if view.claimed():
                writer = view.writer(header.writer)
                return f"process {writer} {_name_of(writer)}publishes to it"
            if header.writer == h.PLC and _beats(view, header.heartbeat):
                return "a PLC publishes to it"
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
    return ", ".join(f"process {pid} {_name_of(pid)}uses it" for pid in pids) or hidden


def orphan_semaphores(processes: Processes) -> list[str]:
    """Return temporary semaphore files that are older than AGE and that no process uses.

    Skip names that a user may have chosen, such as `sem.camera`. `shmgen clean NAME` also removes skipped files.
    """
    if not os.access(FOLDER, os.R_OK):
        return []
    orphans = []
    for name in sorted(os.listdir(FOLDER)):
        if not _TEMPORARY.fullmatch(name) or _WORD.fullmatch(name):
            continue
        file = f"{FOLDER}/{name}"
        with suppress(OSError):  # the semaphore was completed meanwhile
            status = os.lstat(file)
            settled = time.time() - status.st_ctime > AGE
            alone = not os.path.lexists(region_file(name.removeprefix("sem.")))
            unused = not processes.users(status)
            if status.st_size in (0, *SIZES) and settled and alone and unused and not has_open(status):
                orphans.append(file)
    return orphans


def remove(files: list[str]) -> None:
    """Remove the files. Mark a region as removed first, so that processes that have the region open notice.

    A PLC that only reads may still have the region open, because in_use() cannot detect this PLC. Raises
    PermissionDenied if this user may not remove a file.
    """
    for file in files:
        try:
            if not _retire(file):
                os.unlink(file)
        except FileNotFoundError:
            continue
        except PermissionError:
            owner = os.lstat(file).st_uid
            raise PermissionDenied(
                f"{file} belongs to user {owner}; only the owner and root may remove files in {FOLDER}: "
                "run this with sudo"
            ) from None


def _retire(file: str) -> bool:
    """Mark a region as removed and remove its file. Return True if both succeeded.

    If the result is True, the caller must not remove the path again: another process may already have created a new
    region at this path.
    """
    with suppress(PermissionError), opened(file, os.O_RDWR) as region:
        return read_header_of(region.fileno()).magic == h.MAGIC and retire(file, region.fileno())
    return False


def _is_unfinished(header: h.Header) -> bool:
    """Return True if a header is incomplete because the creator of the region died while writing the header.

    The creator writes the magic last. The header of a dead creator is therefore all zeros, or complete except for the
    magic.
    """
    return header.magic == 0 and (header.header_size == h.HEADER_SIZE or not any(header[1:]))


def _name_of(pid: int) -> str:
    name = called(pid)
    return f"({name}) " if name else ""


def _beats(view: View, before: int) -> bool:
    deadline = time.monotonic() + _WATCH
    while time.monotonic() < deadline:
        if view.header().heartbeat != before:
            return True
        time.sleep(0.005)
    return False
