"""Turns the protocol into eight wrong ones, which the chaos test must find: each function plants one in this process.

All are for Python writers and readers; the processes that chaos.py forks inherit them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from shmgen.runtime.region import header as h
from shmgen.runtime.reference import opening
from shmgen.runtime.region import resource
from shmgen.runtime.reference.lock import Lock
from shmgen.runtime.reference.region import Region

PUBLISHER, SUBSCRIBER = 1, 2
"""Places in the classes of a message."""


def one_slot(stage: Any) -> None:
    """Every sample lies in slot 0: a writer that dies half-way destroys the last complete one."""
    sample = Region.sample
    Region.sample = lambda region, number: sample(region, 0)  # type: ignore[method-assign]
    in_python(stage)


def completed_first(stage: Any) -> None:
    """The writer says that a sample is there, and then copies it."""

    def plant(publisher: Any) -> None:
        words = publisher._region.words
        swap_map(publisher, lambda: words.__setitem__(h.COMPLETED, words[h.BEGUN]))

    after_opening(stage, PUBLISHER, plant)


def no_begun(stage: Any) -> None:
    """The writer does not say what it begins."""

    class Words(Wrapped):
        def __setitem__(self, where: int, value: int) -> None:
            if where != h.BEGUN:
                self.inner[where] = value

    after_opening(stage, PUBLISHER, lambda publisher: swap(publisher, publisher._region.words, Words))


def begun_late(stage: Any) -> None:
    """The writer says what it begins, in `begun` and in the slot, when the copy is made."""

    class Words(Wrapped):
        number: int | None = None

        def __setitem__(self, where: int, value: int) -> None:
            if where == h.BEGUN:
                self.number = value
                return
            if where == h.COMPLETED and self.number is not None:
                self.inner[h.BEGUN] = self.number
            self.inner[where] = value

    class Map(Wrapped):
        def __setitem__(self, where: slice, data: Any) -> None:
            message = where.start + h.SLOT_HEADER
            self.inner[message : where.stop] = data[h.SLOT_HEADER :]
            self.inner[where.start : message] = data[: h.SLOT_HEADER]

    def plant(publisher: Any) -> None:
        swap(publisher, publisher._region.words, Words)
        swap(publisher, publisher._region.map, Map)

    after_opening(stage, PUBLISHER, plant)


def number_alone(stage: Any) -> None:
    """The reader looks at the slot's number before the copy, and not at `begun`."""

    def plant(subscriber: Any) -> None:
        number = 0

        class Quads(Wrapped):
            def __getitem__(self, where: int) -> Any:  # the stamp, before the copy
                nonlocal number
                number = subscriber._region.words[2 * (where + h.NUMBER)]
                return self.inner[where]

        class Words(Wrapped):
            def __getitem__(self, where: int) -> Any:
                return number if where == h.BEGUN or where > h.HEADER_SIZE // 4 else self.inner[where]

        swap(subscriber, subscriber._region.quads, Quads)
        swap(subscriber, subscriber._region.words, Words)

    after_opening(stage, SUBSCRIBER, plant)


# --- which only what chaos_mishaps.py does brings to light ---------------------------------------------------


def claim_kept(stage: Any) -> None:
    """A forked child keeps the open file of the region, and with it the claim, beyond its parent's death."""
    close = Region.close

    class Nothing(set[Any]):
        def add(self, made: Any) -> None:
            pass

    def kept(self: Region, gone: Any = None) -> None:
        if os.getpid() == self.pid:
            close(self, gone)

    Region.close = kept  # type: ignore[method-assign]
    resource._kept = Nothing()  # type: ignore[assignment]


def second_token(stage: Any) -> None:
    """Who comes out of the lock posts it although there is a token already."""
    opening.LOCK_MOST = 1 << 30
    in_python(stage)


def lock_lost(stage: Any) -> None:
    """An exception on the way keeps the lock."""
    leave = Lock.leave

    def kept(self: Lock, error: BaseException | None = None) -> bool:
        return isinstance(error, ValueError) and leave(self, error)

    Lock.leave = kept  # type: ignore[method-assign]
    in_python(stage)


CALM: tuple[Callable[[Any], None], ...] = (one_slot, completed_first, no_begun, begun_late, number_alone)
"""What kills and stops alone bring to light."""
PLANTED: dict[str, Callable[[Any], None]] = {
    plant.__name__: plant for plant in (*CALM, claim_kept, second_token, lock_lost)
}


class Wrapped:
    """The region's words, or its map, for a subclass to change."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def __getitem__(self, where: Any) -> Any:
        return self.inner[where]

    def __setitem__(self, where: Any, value: Any) -> None:
        self.inner[where] = value

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


def in_python(stage: Any) -> None:
    """Nobody takes the way in C, in which no fault is planted: those who do would mend what others did wrong."""
    for which in (PUBLISHER, SUBSCRIBER):
        after_opening(stage, which, lambda side: side._disconnect())


def after_opening(stage: Any, which: int, plant: Callable[[Any], None]) -> None:
    """Lets `plant` change each new publisher, or subscriber."""
    for kinds in stage.classes.values():
        _plant(kinds[which], plant)


def _plant(kind: Any, plant: Callable[[Any], None]) -> None:
    opening = kind.__init__

    def __init__(self: Any, *arguments: Any, **options: Any) -> None:
        opening(self, *arguments, **options)
        plant(self)

    kind.__init__ = __init__


def swap(side: Any, old: Any, wrapper: Callable[[Any], Any]) -> Any:
    """Wraps what publish() or read() has at hand."""
    new = wrapper(old)
    side._disconnect()
    side._hot = tuple(new if item is old else item for item in side._hot)
    return new


def swap_map(publisher: Any, before: Callable[[], None]) -> None:
    """Does something before each copy into the region."""

    class Map(Wrapped):
        def __setitem__(self, where: Any, value: Any) -> None:
            before()
            self.inner[where] = value

    publisher._region.map = swap(publisher, publisher._region.map, Map)
