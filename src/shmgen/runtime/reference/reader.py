"""Reads the samples of a region (docs/protocol.md, "Read")."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Generator
from contextlib import suppress
from typing import Any

from shmgen.core import abi
from shmgen.runtime.messages.steps import has_table
from shmgen.runtime.reference.end import End, NotOpenYet
from shmgen.runtime.reference.lock import LOCK_TIMEOUT, Lock
from shmgen.runtime.reference.memory_order import fence
from shmgen.runtime.reference.opening import open_region
from shmgen.runtime.refusals import borrowed_already
from shmgen.runtime.region import header as h

_TRIES = 8
"""The number of attempts of one call to copy a sample that the writer does not overwrite during the copy."""
_POLL = abi.POLL_MS / 1000
"""Seconds between two checks of a waiting reader.

Python cannot wait for a semaphore with a timeout on the monotonic clock.
"""


class Reader(End):
    """The reader of a topic: copies samples out of the topic's region.

    `last` is the number of the newest sample that counts as read, even if the reader skipped it. `sequence` and `stamp`
    belong to the newest sample that a call returned.
    """

    beat = 0
    """The heartbeat at the time of opening."""
    last = 0
    sequence = 0
    stamp = 0
    missed = 0

    def _open(self) -> Generator[int, None, None]:
        of = self.of
        self.region = region = yield from open_region(of)
        self.lock = Lock(region, LOCK_TIMEOUT if of.lock_ns < 0 else of.lock_ns / 1e9)
        self.beat = region.words[h.HEARTBEAT]
        self.last = 0 if of.history or self.lost else max(0, region.newest() - 1)
        self.closed_error = None

    def read(self, left: int | None = None) -> Any:
        """Return the newest message, or None if no unread message can be read.

        `left` is the remaining time in ns of the caller's timeout.
        """
        data = self._read_unread(False, None if left is None else left / 1e9)
        return None if data is None else self.of.kind.from_buffer(data)

    def next(self) -> Any:
        """Return the oldest unread message that is not overwritten yet, or None."""
        data = self._read_unread(True, None)
        return None if data is None else self.of.kind.from_buffer(data)

    def read_into(self, message: Any) -> bool:
        """Read the newest sample into `message`. Return False if no unread sample can be read."""
        data = self._read_unread(False, None)
        if data is None:
            return False
        if type(message) is self.of.kind:
            ctypes.memmove(ctypes.addressof(message), bytes(data), len(data))
        else:
            if not has_table(self.of.kind):
                raise TypeError(f"{self.of.kind!r} has no table of fields: read into an object of it")
            self.of.kind._decode(data, message)
        return True

    def borrow(self) -> int | None:
        """Return the offset in bytes of the newest message in the region, or None if no unread message can be read.

        On machines that need the lock (not x86), hold the lock until give_back().
        """
        with suppress(NotOpenYet):
            return self._call_alone(self._borrow)
        return None

    def give_back(self) -> bool:
        """Release the borrowed sample. Return True if the sample was not overwritten and therefore counts as read."""
        return self._call_alone(self._give_back)

    def ready(self, ns: int) -> bool:
        """Return True as soon as there is an unread sample, or False after `ns` nanoseconds."""
        deadline = time.monotonic() + ns / 1e9
        while not self._inspect(self._has_unread, False):
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            time.sleep(min(left, _POLL))
        return True

    def skip(self) -> None:
        """Mark all existing samples as read, without reading them."""
        self.last = self.newest()

    def newest(self) -> int:
        """Return the number of the newest sample, or 0 before the first."""
        return self._inspect(self._newest, 0)

    def _newest(self) -> int:
        self._has_unread()
        return self.region.newest()

    def _has_unread(self) -> bool:
        if self.region.newest() in (0, self.last):
            self._need_region()
            return False
        return True

    def _read_unread(self, oldest: bool, left: float | None) -> bytearray | None:
        try:
            return self._call_alone(self._find, oldest, left)
        except NotOpenYet:
            return None

    def _unread(self) -> int:
        newest = self.region.newest()
        if newest in (0, self.last):
            return 0
        unread = h.steps(self.last, newest, self.region.header.slots)
        if unread >= abi.RESTART_GAP:  # the region was recreated: its numbers start again
            self.last, unread = newest - 1, 1
        return unread

    def _find(self, oldest: bool, left: float | None) -> bytearray | None:
        for attempt in range(_TRIES):
            unread, slots, start = self._unread(), self.region.header.slots, self.last
            if not unread:
                self._need_region()
                break
            # The writer overwrites the oldest samples first, so each attempt begins closer to the newest sample.
            older = min(unread - 1, slots + abi.LEFT_OUT) >> 2 * attempt if oldest else 0
            for step in range(unread - older, unread + 1):
                data = self._copy(h.after(start, step, slots), left)
                if data is not None:
                    return data or None
        return None

    def _copy(self, number: int, left: float | None) -> bytearray | None:
        """Return the payload of sample `number`, or None if the sample was overwritten.

        Return an empty payload if this machine needs the lock and the lock is not free in time.
        """
        region = self.region
        try:
            if not self.lock.acquire(left) and not self.lock.keeps_order:
                return bytearray()
            if not (slot := region.find(number)):
                return None
            stamp = region.quads[slot // 8 + h.STAMP]
            data = bytearray(region.map[region.payload(slot)])
            fence()
            # Check the number again after the copy: a writer clears the number before it overwrites a slot.
            if not region.is_whole(number, slot):
                return None
        finally:
            self.lock.release()
        self._count(number)
        self.sequence, self.stamp = number, stamp
        self._check()  # the writer may be a PLC, which does not check for a removed region
        return data

    def _borrow(self) -> int | None:
        if self.borrowed:
            raise borrowed_already(self.of)
        if not self._unread():
            self._need_region()
            return None
        if not (self.lock.keeps_order or self.lock.acquire()):
            return None
        number = self.region.newest()
        slot = self.region.find(number)
        if not slot:
            self.lock.release()
            return None
        self.borrowed = number
        self._count(number)  # no other call may deliver the same sample again
        return int(self.region.payload(slot).start)

    def _give_back(self) -> bool:
        number, self.borrowed = self.borrowed, 0
        fence()
        slot = self.region.find(number)
        stamp = self.region.quads[slot // 8 + h.STAMP]
        whole = bool(slot) and self.region.is_whole(number, slot)
        if not whole:
            self._miss(1)
        elif self.last == number:  # if not equal, a newer sample was read meanwhile
            self.sequence, self.stamp = number, stamp
        self._check()
        return whole

    def _count(self, number: int) -> None:
        skipped = h.steps(self.last, number, self.region.header.slots) - 1
        if 0 < skipped < abi.RESTART_GAP:
            self._miss(skipped)
        self.last = number

    def _miss(self, samples: int) -> None:
        """Count samples that were overwritten before they were read."""
        words = self.region.words
        self.missed += samples
        if not self.of.passive:
            # Added without the lock: of two concurrent additions one may be lost. The field is informative only.
            words[h.MISSED] = words[h.MISSED] + samples & h.LAST
