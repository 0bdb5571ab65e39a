"""Reads the samples of a region (docs/protocol.md, "Reading")."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Generator
from typing import Any

from shmgen.core import abi
from shmgen.runtime.reference.end import End
from shmgen.runtime.reference.lock import LOCK_TIMEOUT, Lock
from shmgen.runtime.reference.memory_order import fence
from shmgen.runtime.reference.opening import open_region
from shmgen.runtime.refusals import borrowed_already
from shmgen.runtime.region import header as h

_TRIES = 8
"""How often a sample overwritten while it was copied is given up for a newer one in one call."""
_POLL = abi.POLL_MS / 1000
"""Seconds between two looks of a reader that waits: Python has no wait for a semaphore by a clock that nobody sets."""


class Reader(End):
    """A reader of a topic. `last` is the number of the sample that counts as read, `sequence` of one really read."""

    beat = 0
    """The heartbeat as it was at the opening."""
    last = 0
    sequence = 0
    stamp = 0
    missed = 0

    def _open(self) -> Generator[int, None, None]:
        of = self.of
        self.region = region = yield from open_region(of)
        self.lock = Lock(region, LOCK_TIMEOUT if of.lock_ns < 0 else of.lock_ns / 1e9)
        self.beat = region.words[h.HEARTBEAT]
        self.last = 0 if of.history else max(0, region.newest() - 1)
        self.gone = None

    def read(self, left: int | None = None) -> Any:
        """The newest message, None without an unread one that can be had. `left`: ns of a call that ends then."""
        data = self._one_call(self._find, False, None if left is None else left / 1e9)
        return None if data is None else self.of.kind.from_buffer(data)

    def next(self) -> Any:
        """The oldest unread one that is still there."""
        data = self._one_call(self._find, True, None)
        return None if data is None else self.of.kind.from_buffer(data)

    def read_into(self, message: Any) -> bool:
        """As read(), but fills `message`; True = there was one."""
        data = self._one_call(self._find, False, None)
        if data is None:
            return False
        if type(message) is self.of.kind:
            ctypes.memmove(ctypes.addressof(message), bytes(data), len(data))
        else:
            self.of.kind._decode(data, 0, message)
        return True

    def borrow(self) -> int | None:
        """Where the newest message lies in the region, to read it there; None without an unread one that can be had.

        Where the lock is needed it is held until give_back().
        """
        return self._one_call(self._borrow)

    def give_back(self) -> bool:
        """Whether what was borrowed stayed whole, and so counts as read."""
        return self._one_call(self._give_back)

    def ready(self, ns: int) -> bool:
        """Whether there is an unread sample, as soon as there is one or after that time."""
        deadline = time.monotonic() + ns / 1e9
        while self.newest() in (0, self.last):
            left = deadline - time.monotonic()
            if left > 0:
                self.is_removed()
            self._need_region()
            if left <= 0:
                return False
            time.sleep(min(left, _POLL))
        return True

    def skip(self) -> None:
        """What is there counts as read."""
        self.last = self.newest()

    def newest(self) -> int:
        """Number of the newest sample, 0 = none yet."""
        self.load(0)
        return self.region.newest()

    def _unread(self) -> int:
        newest = self.region.newest()
        if newest in (0, self.last):
            return 0
        unread = h.steps(self.last, newest, self.region.header.slots)
        if unread >= abi.RESTART_GAP:  # the region was begun anew and counts from 1 again
            self.last, unread = newest - 1, 1
        return unread

    def _find(self, oldest: bool, left: float | None) -> bytearray | None:
        for _ in range(_TRIES):
            unread, slots, start = self._unread(), self.region.header.slots, self.last
            if not unread:
                self._need_region()
                break
            for step in range(max(1, unread - slots - abi.LEFT_OUT) if oldest else unread, unread + 1):
                data = self._copy(h.after(start, step, slots), left)
                if data is not None:
                    return data or None
        return None

    def _copy(self, number: int, left: float | None) -> bytearray | None:
        """The payload of sample `number`; None if it was overwritten, empty where the lock is needed and not free."""
        region = self.region
        try:
            if not self.lock.acquire(left) and not self.lock.keeps_order:
                return bytearray()
            if not (slot := region.find(number)):
                return None
            stamp = region.quads[slot // 8 + h.STAMP]
            data = bytearray(region.map[region.payload(slot)])
            fence()
            # Again after the copy: a writer clears the number of what it is about to overwrite.
            if not region.is_whole(number, slot):
                return None
        finally:
            self.lock.release()
        self._count(number, stamp)
        return data

    def _borrow(self) -> int | None:
        if self.borrowed:
            raise borrowed_already(self.of)
        if not self._unread() or not (self.lock.keeps_order or self.lock.acquire()):
            return None
        number = self.region.newest()
        slot = self.region.find(number)
        if not slot:
            self.lock.release()
            return None
        self.borrowed = number
        return int(self.region.payload(slot).start)

    def _give_back(self) -> bool:
        number, self.borrowed = self.borrowed, 0
        fence()
        slot = self.region.find(number)
        stamp = self.region.quads[slot // 8 + h.STAMP]
        whole = bool(slot) and self.region.is_whole(number, slot)
        if whole:
            self._count(number, stamp)
        return whole

    def _count(self, number: int, stamp: int) -> None:
        words = self.region.words
        skipped = h.steps(self.last, number, self.region.header.slots) - 1
        if 0 < skipped < abi.RESTART_GAP:
            self.missed += skipped
            if not self.of.passive:
                # Outside of the lock: of two readers that add at once one may be lost, which a figure survives.
                words[h.MISSED] = words[h.MISSED] + skipped & h.LAST
        self.last = self.sequence = number
        self.stamp = stamp
