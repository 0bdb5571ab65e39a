"""Turns a region into the samples that come, for those who look on: nothing is written to it, no lock is taken.

Where a machine keeps the order of loads and stores, the slots alone carry integrity, and a read-only mapping is
enough: no writer and no reader can feel it. Elsewhere a Tap reads as a Subscriber does, with its lock.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from shmgen.core import abi
from shmgen.live.classes import subscriber
from shmgen.live.regions import View, depth_of, sound, topic_of
from shmgen.runtime import Message
from shmgen.runtime.region import header as h
from shmgen.runtime.region.memory_order import keeps_order, ordered

_TRIES = 8


class Sample(NamedTuple):
    """`stamp`: nanoseconds since 1970 when its writer wrote it, 0 if that has no clock."""

    number: int
    stamp: int
    payload: bytes | bytearray


class Tap(Protocol):
    """What tells of a region's samples; the newest that is there at first counts as one that comes."""

    missed: int
    """Samples that were overwritten before they could be taken."""

    def take(self) -> list[Sample]:
        """What has come since, the oldest first."""

    def finish(self) -> None:
        """Counts as missed what came and is not taken any more."""

    def close(self) -> None: ...


def tap(view: View, kind: type[Message] | None = None, *, whole: bool = False) -> Tap:
    """Of the region that is open in `view`; `kind`, its class, is needed where the order is not kept.

    `whole`: what was written before counts as well, as missed if it is not there any more.
    Raises RegionUnusable for a damaged one, and what a Subscriber raises.
    """
    header = sound(view)
    if keeps_order() or kind is None:
        return Onlooker(view, header, whole)
    return Reader(kind, topic_of(view.name), depth_of(header), whole)


class Onlooker:
    """Reads between two looks at the words that a writer sets before and after it writes."""

    def __init__(self, view: View, header: h.Header, whole: bool) -> None:
        size = h.HEADER_SIZE + header.slots * header.slot_size
        self._map = view.mapped(size)
        self._words = ordered(memoryview(self._map).cast("I"))
        self._quads = ordered(memoryview(self._map).cast("Q"))
        self._slots = header.slots
        self._places = tuple(_place(header, slot) for slot in range(header.slots))
        self._last = 0 if whole else max(0, self._words[h.COMPLETED] - 1)
        self.missed = 0

    def take(self) -> list[Sample]:
        words = self._words
        newest = words[h.COMPLETED]
        if newest == self._last or newest == 0:
            return []
        taken: list[Sample] = []
        for _ in range(_TRIES):
            start, slots = self._last, self._slots
            unread = h.steps(start, newest, slots)
            if unread >= abi.RESTART_GAP:  # the region was begun anew
                start, unread = newest - 1, 1
                self._last = start
            for step in range(max(1, unread - slots + 1), unread + 1):
                number = h.after(start, step, slots)
                payload, stamp_at, number_at = self._places[number & slots - 1]
                stamp = self._quads[stamp_at]
                data = self._map[payload]
                begun = words[h.BEGUN]
                if words[number_at] != number or h.steps(number, begun, slots) >= slots:
                    continue
                self.missed += h.steps(self._last, number, slots) - 1
                self._last = number
                taken.append(Sample(number, stamp, data))
            newest = words[h.COMPLETED]
            if taken or newest in (0, self._last):
                break
        return taken

    def finish(self) -> None:
        newest = self._words[h.COMPLETED]
        if newest and (left := h.steps(self._last, newest, self._slots)) < abi.RESTART_GAP:
            self.missed += left
            self._last = newest

    def close(self) -> None:
        self._words.release()
        self._quads.release()
        self._map.close()


class Reader:
    """The same through a Subscriber, whose lock then orders what is read."""

    def __init__(self, kind: type[Message], topic: str, depth: int, whole: bool) -> None:
        self._reader = subscriber(kind, topic, depth)
        if whole:
            self._reader._last = 0
        self._reader._make = self._keep
        self._reader._long = False
        self._taken: list[Sample] = []
        self.missed = 0

    def take(self) -> list[Sample]:
        self._reader.read_all()
        self.missed = self._reader.missed
        taken, self._taken = self._taken, []
        return taken

    def finish(self) -> None:
        newest = self._reader._words[h.COMPLETED]
        if newest:
            self.missed += h.steps(self._reader._last, newest, self._reader._slots)

    def close(self) -> None:
        self._reader.close()

    def _keep(self, data: bytes) -> Message:
        """What the subscriber makes of a copied payload: its number and stamp are known at this moment only."""
        self._taken.append(Sample(self._reader._last, self._reader._stamp or 0, data))
        return None  # type: ignore[return-value]


def _place(header: h.Header, slot: int) -> tuple[slice, int, int]:
    """Where the payload of a slot lies, its stamp in steps of eight bytes, its number in steps of four."""
    start = h.HEADER_SIZE + slot * header.slot_size
    payload = slice(start + h.SLOT_HEADER, start + h.SLOT_HEADER + header.payload_size)
    return payload, start // 8 + h.STAMP, 2 * (start // 8 + h.NUMBER)
