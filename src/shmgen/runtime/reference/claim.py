"""Claims a topic for a writer, or raises an error that describes the existing writer."""

from __future__ import annotations

import time
from collections.abc import Generator

from shmgen.core import abi
from shmgen.runtime.errors import RegionInUse
from shmgen.runtime.reference.opening import CONFIRM, WATCH
from shmgen.runtime.reference.region import Region
from shmgen.runtime.region import header as h
from shmgen.runtime.region.checks import region_in_use_error
from shmgen.runtime.region.record_locks import describe_writer

WATCHED = abi.CLAIM_MS / 1000
"""Seconds within which a running PLC increments its heartbeat."""
_CONFIRM = abi.CONFIRM_MS / 1000
"""Seconds to wait after this process has stored its id in `writer`. A concurrent writer overwrites the id meanwhile."""
_STOOD_STILL = _CONFIRM / 2
"""Maximum seconds between the check of `writer` and the store. After a longer time another writer may be claiming."""


def claim(topic: str, region: Region) -> Generator[int, None, tuple[int, int, bool]]:
    """Make this process the writer of the topic. Raises RegionInUse if another writer is active.

    Return three values. The first is the sample number before the first new sample. The second is the new value of the
    header field `turn`. The third is True if a stopped writer, such as a PLC, may still write.
    The caller's record lock excludes other processes. A PLC knows no record locks. To exclude a PLC, watch its
    heartbeat, store this process's id in `writer`, wait, and check that the id is unchanged.
    A stopped PLC may continue its write at any time. To keep both writers apart, use the other lane, which is the other
    half of the region's slots, and skip the sample number that the PLC would use next.
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
    _begin_numbers(topic, region)
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
    if there and (last + 1 - there) % slots == 0:  # do not write into the slot of the newest sample
        words[h.LEFT] = last = h.after(last, 1, slots)
    if doubtful:
        words[h.TURN] = turn
    return last, turn, doubtful


def _begin_numbers(topic: str, region: Region) -> None:
    """Choose the first sample number of a new request region by the clock, to repeat no number of a removed region.

    A server may still answer a request of the removed region, and the client distinguishes responses only by number.
    Readers treat a first number of RESTART_GAP or more as a restart, and count no sample as missed.
    """
    if topic.endswith(("-request", "-goal")) and not region.newest() and not region.words[h.LEFT]:
        region.words[h.LEFT] = abi.RESTART_GAP | time.monotonic_ns() // 1000 % abi.RESTART_GAP


def _begin_turn(region: Region) -> int:
    """Begin to take over the topic from a stopped writer: make the header field `turn` odd, and return its new value.

    An odd value means that the takeover is incomplete. Skip the sample number that the stopped writer may still use.
    Call this function before you store this process's id in `writer`. If this process then dies, the next writer finds
    the id and begins a takeover as well.
    """
    words = region.words
    words[h.LEFT] = h.after(h.later(region.newest(), words[h.LEFT]), 1, region.header.slots)
    words[h.TURN] = turn = words[h.TURN] | 1
    return int(turn)


def _in_use(topic: str, region: Region) -> RegionInUse:
    return region_in_use_error(topic, describe_writer(region.file, region.words[h.WRITER]))
