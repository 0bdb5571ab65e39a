"""Turns a region into one that this process writes, or into who else does."""

from __future__ import annotations

import time
from collections.abc import Generator

from shmgen.core import abi
from shmgen.runtime.errors import RegionInUse
from shmgen.runtime.reference.opening import CONFIRM, WATCH
from shmgen.runtime.reference.region import Region
from shmgen.runtime.refusals import in_use
from shmgen.runtime.region import header as h
from shmgen.runtime.region.looks import WRITER_LOCK, writer_of

WATCHED = abi.CLAIM_MS / 1000
"""Seconds within which a PLC that still runs increments its heartbeat."""
_CONFIRM = abi.CONFIRM_MS / 1000
"""Seconds within which whoever claimed at the same time has put his name over ours."""
_STOOD_STILL = _CONFIRM / 2
"""Seconds from a look to our name, behind which somebody else may have begun meanwhile."""


def claim(topic: str, region: Region) -> Generator[int, None, tuple[int, bool]]:
    """Makes this process the topic's writer. Raises RegionInUse.

    Returns the number after which the samples begin, and whether a PLC may have gone on until now. A record lock keeps
    other processes out. A PLC knows no such lock: it is watched, then this process puts its name into `writer`, waits,
    and looks whether it still stands. A PLC that was only standing still may go on with a write of its own at any
    time, so its numbers are left to it: ours begin a turn of the slots later.
    """
    words = region.words
    if not region.lock_byte(WRITER_LOCK):
        raise _in_use(topic, region)
    doubtful = False
    looked = time.monotonic()
    if words[h.WRITER] == h.PLC:
        before, deadline = words[h.HEARTBEAT], looked + WATCHED
        while words[h.WRITER] and not doubtful:
            if words[h.WRITER] != h.PLC or words[h.HEARTBEAT] != before:
                raise _in_use(topic, region)
            yield WATCH
            looked = time.monotonic()
            doubtful = looked >= deadline
    words[h.WRITER] = region.pid
    named = time.monotonic()
    doubtful = doubtful or named - looked > _STOOD_STILL
    while doubtful and time.monotonic() < named + _CONFIRM:
        yield CONFIRM
    if doubtful and words[h.WRITER] != region.pid:
        raise _in_use(topic, region)
    newest, slots = words[h.COMPLETED], region.header.slots
    return (h.after(newest, slots, slots) if doubtful else newest), doubtful


def _in_use(topic: str, region: Region) -> RegionInUse:
    return in_use(topic, writer_of(topic, region.file, region.words[h.WRITER]))
