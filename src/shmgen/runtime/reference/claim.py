"""Claims a region for the one that writes it, or says who else does."""

from __future__ import annotations

import time
from collections.abc import Generator

from shmgen.core import abi
from shmgen.runtime.errors import RegionInUse
from shmgen.runtime.reference.opening import CONFIRM, WATCH
from shmgen.runtime.reference.region import Region
from shmgen.runtime.region import header as h
from shmgen.runtime.region.looks import in_use, writer_of

WATCHED = abi.CLAIM_MS / 1000
"""Seconds within which a PLC that still runs increments its heartbeat."""
_CONFIRM = abi.CONFIRM_MS / 1000
"""Seconds within which whoever claimed at the same time has put his name over ours."""
_STOOD_STILL = _CONFIRM / 2
"""Seconds from a look to our name, behind which somebody else may have begun meanwhile."""


def claim(topic: str, region: Region) -> Generator[int, None, tuple[int, int, bool]]:
    """Makes this process the topic's writer. Raises RegionInUse.

    Returns the number after which the samples begin, the turn, and whether a PLC may have gone on until now. A record
    lock keeps other processes out. A PLC knows no such lock: it is watched, then this process puts its name into
    `writer`, waits, and looks whether it still stands. A PLC that was only standing still may go on with a write of its
    own at any time, so its lane and its next number are left to it.
    """
    words = region.words
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
    doubtful = doubtful or bool(words[h.TURN] & 1)
    turn = _begin_turn(region) if doubtful else 0
    words[h.WRITER] = region.pid
    named = time.monotonic()
    if not doubtful and named - looked > _STOOD_STILL:
        doubtful, turn = True, _begin_turn(region)
    while doubtful and time.monotonic() < named + _CONFIRM:
        yield CONFIRM
    if doubtful and (words[h.WRITER] != region.pid or words[h.TURN] != turn):
        raise _in_use(topic, region)
    turn = words[h.TURN] + doubtful & h.LAST
    last, slots = h.later(region.newest(), words[h.LEFT]), region.header.slots
    there = words[h.COMPLETED0 + h.lane(turn)]
    if there and (last + 1 - there) % slots == 0:  # not into the slot of what may be the newest sample
        words[h.LEFT] = last = h.after(last, 1, slots)
    if doubtful:
        words[h.TURN] = turn
    return last, turn, doubtful


def _begin_turn(region: Region) -> int:
    """Leaves lane and next number to a writer before that may only stand still.

    Before the name, and an odd turn says that nobody has ended it: who comes next, and finds the name of a dead one,
    must begin it too.
    """
    words = region.words
    words[h.LEFT] = h.after(h.later(region.newest(), words[h.LEFT]), 1, region.header.slots)
    words[h.TURN] = turn = words[h.TURN] | 1
    return int(turn)


def _in_use(topic: str, region: Region) -> RegionInUse:
    return in_use(topic, writer_of(topic, region.file, region.words[h.WRITER]))
