"""Turns the protocol into eight wrong ones, which the chaos test must find: each function plants one in this process.

All are planted in the reference in Python, which is then the engine of all; the processes that chaos.py forks have
them too.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

from shmgen.runtime.reference.lock import Lock
from shmgen.runtime.reference.region import Region
from shmgen.runtime.reference.semaphores import PosixSemaphore
from shmgen.runtime.region import header as h

from .chaos_mishaps import Interrupted

PUBLISHER, SUBSCRIBER = 1, 2
"""Places in the classes of a message."""


def one_slot(stage: Any) -> None:
    """Every sample lies in slot 0: a writer that dies half-way destroys the last complete one."""
    slot = Region.slot
    Region.slot = lambda region, number: slot(region, 0)  # type: ignore[method-assign]


def completed_first(stage: Any) -> None:
    """The writer says that a sample is there, and then copies it."""

    def plant(publisher: Any) -> None:
        words = publisher._end.region.words
        swap_map(publisher, lambda: words.__setitem__(h.COMPLETED, words[h.BEGUN]))

    after_opening(stage, PUBLISHER, plant)


def no_begun(stage: Any) -> None:
    """The writer does not say what it begins."""

    class Words(Wrapped):
        def __setitem__(self, where: int, value: int) -> None:
            if where != h.BEGUN:
                self.inner[where] = value

    after_opening(stage, PUBLISHER, lambda publisher: swap(publisher, "words", Words))


def begun_late(stage: Any) -> None:
    """The writer says what it begins, in `begun` and in the slot, when the copy is made."""

    class Words(Wrapped):
        def __setitem__(self, where: int, value: int) -> None:
            if where == h.BEGUN or where >= h.HEADER_SIZE // 4:
                self.late[where] = value
                return
            if where == h.COMPLETED:
                for begun, number in self.late.items():
                    self.inner[begun] = number
                self.late.clear()
            self.inner[where] = value

        def __init__(self, inner: Any) -> None:
            super().__init__(inner)
            self.late: dict[int, int] = {}

    after_opening(stage, PUBLISHER, lambda publisher: swap(publisher, "words", Words))


def number_alone(stage: Any) -> None:
    """The reader looks at the slot's number before the copy, and not at `begun`."""

    def plant(subscriber: Any) -> None:
        words, number = subscriber._end.region.words, 0

        class Quads(Wrapped):
            def __getitem__(self, where: int) -> Any:  # the stamp, before the copy
                nonlocal number
                number = words[2 * (where + h.NUMBER)]
                return self.inner[where]

        class Words(Wrapped):
            def __getitem__(self, where: int) -> Any:
                return number if where == h.BEGUN or where > h.HEADER_SIZE // 4 else self.inner[where]

        swap(subscriber, "quads", Quads)
        swap(subscriber, "words", Words)

    after_opening(stage, SUBSCRIBER, plant)


# --- which only what chaos_mishaps.py does brings to light ---------------------------------------------------


def claim_kept(stage: Any) -> None:
    """A forked child keeps the open file of the region, and with it the claim, beyond its parent's death."""
    close, held = Region.close, []

    def kept(self: Region) -> None:
        if os.getpid() == self.pid:
            close(self)
        else:
            held.append(self)

    Region.close = kept  # type: ignore[method-assign]


def second_token(stage: Any) -> None:
    """Who comes out of the lock posts it although there is a token already."""

    def post(self: Any) -> bool:
        self._inner.release()
        self.held.clear()
        return True

    PosixSemaphore.post = post  # type: ignore[method-assign]


def lock_lost(stage: Any) -> None:
    """An exception on the way keeps the lock."""
    release = Lock.release

    def kept(self: Lock) -> None:
        if isinstance(sys.exc_info()[1], Interrupted):
            self._region.semaphore.held.clear()
        release(self)

    Lock.release = kept  # type: ignore[method-assign]


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


def swap(side: Any, what: str, wrapper: Callable[[Any], Any]) -> None:
    """Wraps the words, the quads or the map of a publisher or subscriber of the reference."""
    region = side._end.region
    setattr(region, what, wrapper(getattr(region, what)))


def swap_map(publisher: Any, before: Callable[[], None]) -> None:
    """Does something before each copy into the region."""

    class Map(Wrapped):
        def __setitem__(self, where: Any, value: Any) -> None:
            before()
            self.inner[where] = value

    swap(publisher, "map", Map)
