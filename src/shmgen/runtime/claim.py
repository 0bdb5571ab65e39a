"""Turns a region into one that this process writes, or into who else does."""

from __future__ import annotations

import time

from shmgen import abi
from shmgen.runtime import header as h
from shmgen.runtime.errors import LockTimeout, RegionInUse
from shmgen.runtime.holders import holder
from shmgen.runtime.lock import Lock, fence
from shmgen.runtime.region import WRITER_LOCK, Region

WATCH = abi.CLAIM_MS / 1000
"""Seconds within which a PLC that still runs counts its heartbeat up."""
_LOOK = 2e-3
"""Seconds between two looks at it."""
_LOCK_WITHIN = 2.5
"""Seconds within which the lock of a dead one has been taken over."""
_STORE = 1e-3
"""Seconds within which any store is seen by all."""


def claim(region: Region, lock: Lock) -> None:
    """Makes this process the topic's writer. Raises RegionInUse and LockTimeout.

    A record lock keeps other Pythons out. A PLC knows no such lock: it is seen to count its heartbeat up, and looks
    at `writer` inside the lock before each write. So the claim is written inside the lock too, and a look after it
    shows a PLC that has claimed at the same instant, or goes on without the lock.
    """
    if not region.lock_byte(WRITER_LOCK):
        raise RegionInUse(
            f"{region.topic}: {writer(region)} publishes already; one writer a topic: stop that one first"
        )
    words = region.words
    seen = words[h.WRITER], words[h.HEARTBEAT]
    if seen[0] == h.PLC:
        seen = _watch(region, seen)
    try:
        if region.options.sync != "sequence" and not lock.enter(_LOCK_WITHIN):
            raise LockTimeout(f"{region.topic}: the lock was not free within {_LOCK_WITHIN} s; see `shmgen doctor`")
        if (words[h.WRITER], words[h.HEARTBEAT]) != seen:
            raise _in_use(region)
        words[h.WRITER] = region.pid
    finally:
        lock.leave()
    fence()
    if region.options.sync == "sequence":
        time.sleep(_STORE)
    if (words[h.WRITER], words[h.HEARTBEAT]) != (region.pid, seen[1]):
        raise _in_use(region)


def writer(region: Region) -> str:
    """Who writes, for people."""
    pid = holder(region.file, WRITER_LOCK)
    if pid:
        return f"process {pid}"
    said = region.words[h.WRITER]
    return "a PLC" if said == h.PLC else f"process {said}"


def _watch(region: Region, seen: tuple[int, int]) -> tuple[int, int]:
    """`writer` and `heartbeat` once they have stood still for long enough, or the PLC has let go."""
    deadline = time.monotonic() + WATCH
    while time.monotonic() < deadline:
        now = region.words[h.WRITER], region.words[h.HEARTBEAT]
        if now[0] == 0:
            return now
        if now != seen:
            raise _in_use(region)
        time.sleep(_LOOK)
    return seen


def _in_use(region: Region) -> RegionInUse:
    return RegionInUse(f"{region.topic}: a PLC publishes already; one writer a topic: stop its publisher block first")
