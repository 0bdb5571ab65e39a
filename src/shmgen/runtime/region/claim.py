"""Turns a region into one that this process writes, or into who else does."""

from __future__ import annotations

import time
from typing import NamedTuple

from shmgen.core import abi
from shmgen.runtime.errors import RegionInUse
from shmgen.runtime.region import header as h
from shmgen.runtime.region.holders import holder
from shmgen.runtime.region.region import WRITER_LOCK, Region

WATCH = abi.CLAIM_MS / 1000
"""Seconds within which a PLC that still runs counts its heartbeat up."""
_CONFIRM = abi.CONFIRM_MS / 1000
"""Seconds within which whoever claimed at the same time has put his name over ours."""
_STOOD_STILL = _CONFIRM / 2
"""Seconds from a look to our name, behind which somebody else may have begun meanwhile."""
_LOOK = 2e-3
"""Seconds between two looks at a PLC."""


class Claim(NamedTuple):
    """`sequence` is the number after which the samples begin; `doubtful`: a PLC may have gone on until now."""

    sequence: int
    doubtful: bool


def claim(region: Region) -> Claim:
    """Makes this process the topic's writer. Raises RegionInUse.

    A record lock keeps other Pythons out. A PLC knows no such lock: it is watched, then this process puts its name
    into `writer`, waits, and looks whether it still stands. A PLC that was only standing still may go on with a
    write of its own at any time, so its numbers are left to it: ours begin a turn of the slots later.
    """
    if not region.lock_byte(WRITER_LOCK):
        raise _in_use(region)
    words = region.words
    doubtful = False
    while True:
        looked = time.monotonic()
        if words[h.WRITER] != h.PLC or (doubtful := _stands_still(region)):
            break
    words[h.WRITER] = region.pid
    doubtful = doubtful or time.monotonic() - looked > _STOOD_STILL
    if doubtful:
        time.sleep(_CONFIRM)
        if words[h.WRITER] != region.pid:
            raise _in_use(region)
    newest = words[h.COMPLETED]
    slots = region.header.slots
    return Claim(h.after(newest, slots, slots) if doubtful else newest, doubtful)


def writer(region: Region) -> str:
    """Who writes, for people."""
    said = region.words[h.WRITER]
    if region.byte_is_locked(WRITER_LOCK):
        pid = holder(region.file, WRITER_LOCK, said)
        return f"process {pid}" if pid else f"process {said} of another user or container"
    return "a PLC" if said == h.PLC else f"process {said}"


def _stands_still(region: Region) -> bool:
    """Watches a PLC for long enough; False: it has let go. Raises RegionInUse where it moves."""
    words = region.words
    before = words[h.HEARTBEAT]
    deadline = time.monotonic() + WATCH
    while time.monotonic() < deadline:
        if not words[h.WRITER]:
            return False
        if words[h.WRITER] != h.PLC or words[h.HEARTBEAT] != before:
            raise _in_use(region)
        time.sleep(_LOOK)
    return True


def _in_use(region: Region) -> RegionInUse:
    return RegionInUse(f"{region.topic}: {writer(region)} publishes already; one writer a topic: stop that one first")
