"""Plants faults in the protocol that the chaos test must detect. Each function plants one fault in this process.

All faults are planted in the reference in Python. chaos.py then lets all processes use the reference, and the processes
that chaos.py forks inherit the fault.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable
from typing import Any

from shmgen.core import abi
from shmgen.runtime.reference import writer
from shmgen.runtime.reference.lock import Lock
from shmgen.runtime.reference.region import Region, Semaphore
from shmgen.runtime.reference.writer import ring
from shmgen.runtime.region import header as h

from .chaos_mishaps import Interrupted

PUBLISHER, SUBSCRIBER = 1, 2
"""Indexes in the tuple of a message's classes."""


def one_slot(stage: Any) -> None:
    """Store every sample in slot 0. A writer that dies during a copy then destroys the last complete sample."""
    slot = Region.slot
    Region.slot = lambda region, number, lane: slot(region, 0, lane)  # type: ignore[method-assign]


def completed_first(stage: Any) -> None:
    """Let the writer mark a sample as complete before it copies the sample."""

    def plant(publisher: Any) -> None:
        end = publisher._end
        words = end.region.words

        def mark_complete() -> None:
            number, lane = end.sequence + 1, words[h.TURN] % abi.LANES
            words[end.region.slot(number, lane) // 4 + 2 * h.NUMBER] = words[h.COMPLETED0 + lane] = number

        swap_map(publisher, mark_complete)

    after_opening(stage, PUBLISHER, plant)


def not_cleared(stage: Any) -> None:
    """Let the writer keep the old number of a slot while it copies a sample into the slot."""

    class Words(Wrapped):
        def __setitem__(self, key: int, value: int) -> None:
            if value or key < h.HEADER_SIZE // 4:
                self.inner[key] = value

    after_opening(stage, PUBLISHER, lambda publisher: swap(publisher, "words", Words))


def one_look(stage: Any) -> None:
    """Let the reader compare the slot's number only before the copy, and not after it."""

    def plant(subscriber: Any) -> None:
        region = subscriber._end.region

        def find(number: int) -> int:
            region.is_whole = functools.partial(Region.is_whole, region)
            slot = Region.find(region, number)
            region.is_whole = lambda *_: True
            return slot

        region.find = find

    after_opening(stage, SUBSCRIBER, plant)


# --- faults that only the mishaps of chaos_mishaps.py reveal -------------------------------------------------


def claim_kept(stage: Any) -> None:
    """Let a forked child keep the region's open file, and therefore the claim, after the death of its parent."""
    opening = Region.__init__

    def open_and_duplicate(self: Region, file: Any, *others: Any) -> None:
        opening(self, file, *others)
        os.dup(file.fileno())

    Region.__init__ = open_and_duplicate  # type: ignore[method-assign]


def second_token(stage: Any) -> None:
    """Let a process post more tokens when it releases the lock than it has taken."""

    def post(self: Any) -> bool:
        for _ in range(3):
            self._inner.release()
        self.held.clear()
        return True

    Semaphore.post = post  # type: ignore[method-assign]


def lock_lost(stage: Any) -> None:
    """Let an exception leave the lock acquired."""
    release = Lock.release

    def forget_and_release(self: Lock) -> None:
        if isinstance(sys.exc_info()[1], Interrupted):
            self._region.semaphore.held.clear()
        release(self)

    Lock.release = forget_and_release  # type: ignore[method-assign]


CALM: tuple[Callable[[Any], None], ...] = (one_slot, completed_first, not_cleared, one_look)
"""Faults that kills and stops alone reveal."""
PLANTED: dict[str, Callable[[Any], None]] = {
    plant.__name__: plant for plant in (*CALM, claim_kept, second_token, lock_lost)
}


class Wrapped:
    """A wrapper around the numbers or the map of a region, for subclasses that change an access."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def __getitem__(self, key: Any) -> Any:
        return self.inner[key]

    def __setitem__(self, key: Any, value: Any) -> None:
        self.inner[key] = value

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


def _ring(map: Any) -> None:
    """Call `ring()` with the map inside all wrappers, because the bell needs the map itself."""
    while isinstance(map, Wrapped):
        map = map.inner
    ring(map)


writer.ring = _ring  # type: ignore[attr-defined]


def after_opening(stage: Any, index: int, plant: Callable[[Any], None]) -> None:
    """Call `plant` with each new publisher or subscriber of this process."""
    for kinds in stage.classes.values():
        _plant(kinds[index], plant)


def _plant(kind: Any, plant: Callable[[Any], None]) -> None:
    opening = kind.__init__

    def __init__(self: Any, *arguments: Any, **options: Any) -> None:
        opening(self, *arguments, **options)
        plant(self)

    kind.__init__ = __init__


def swap(endpoint: Any, attribute: str, wrapper: Callable[[Any], Any]) -> None:
    """Replace the attribute `attribute` of an endpoint's region (words, quads or map) by a wrapper."""
    region = endpoint._end.region
    setattr(region, attribute, wrapper(getattr(region, attribute)))


def swap_map(publisher: Any, before: Callable[[], None]) -> None:
    """Call `before` before each copy into the region."""

    class Map(Wrapped):
        def __setitem__(self, key: Any, value: Any) -> None:
            before()
            self.inner[key] = value

    swap(publisher, "map", Map)
