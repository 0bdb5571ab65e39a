"""Turns the samples of a topic's region into messages."""

from __future__ import annotations

import ctypes
import mmap
import time
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, cast

from shmgen.core import abi
from shmgen.runtime import core
from shmgen.runtime.messages.message import LATE_FROM
from shmgen.runtime.region import header as h
from shmgen.runtime.region import semaphores
from shmgen.runtime.region.header import (
    ARMED,
    BEGUN,
    COMPLETED,
    HEARTBEAT,
    LAST,
    LOCK_COUNT,
    LOCK_HOLDER,
    MISSED,
    NUMBER,
    STAMP,
    after,
    steps,
)
from shmgen.runtime.region.lock import Lock
from shmgen.runtime.region.memory_order import fence
from shmgen.runtime.region.opening import open_event, open_region, watch_region
from shmgen.runtime.region.region import Region
from shmgen.runtime.region.resource import ClosedProxy, RegionHolder
from shmgen.runtime.sample import M, Sample

_TRIES = 8
"""How often a sample overwritten while it was copied is given up for a newer one in one call."""
_LOCKED_OUT = b""
"""Instead of a sample, which is never empty: the lock is needed here and was not free in time."""
_RESTART_GAP = abi.RESTART_GAP
"""So many samples cannot have come since the last look: the region was begun anew and counts from 1 again."""
_POLL = abi.POLL_MS / 1000
"""Seconds between two looks of wait() while another reader has the event."""
_SLICE = abi.WAKE_MS / 1000
"""Seconds of the longest single wait: what a lost wake-up costs at most."""


class _AtHand(NamedTuple):
    """What _copy() needs; kept as a plain tuple, as a publisher's is."""

    places: tuple[tuple[slice, int, int], ...]
    map: mmap.mmap
    words: memoryview
    quads: memoryview
    acquire: Callable[[bool], bool] | None
    release: Callable[[], None]
    pid: int


class Subscriber(RegionHolder, core.Reader, Generic[M]):
    """Reads one type from one topic. Not for two threads at a time; forked children open their own."""

    message_type: type[M]
    _word = "subscriber"
    _lock: Lock

    def __init__(
        self,
        topic: str,
        *,
        depth: int = 1,
        lock_timeout: float | None = None,
        mode: int | None = None,
        group: str | int | None = None,
        passive: bool = False,
        history: bool = False,
    ) -> None:
        """Opens the region, or creates it if the writer has not yet; parameters and errors as for a publisher.

        The newest sample published before counts as unread; with `history` all of them do, as missed if they were
        overwritten. `passive` is for tools that watch: the region must be there (RegionMissing), nothing is written
        to it, nobody is kept from being woken, and only where the lock keeps the order (not on x86) it is taken.
        """
        kind = self.message_type
        ours = h.header_for(kind._type_name_, kind._digest_, ctypes.sizeof(kind), depth)
        self._region = region = (watch_region if passive else open_region)(topic, ours, kind._regions_.but(mode, group))
        try:
            self._lock = Lock(region, lock_timeout)
        except BaseException:
            region.close()
            raise
        size = region.header.payload_size
        self._words = region.words
        self._slots = region.header.slots
        # Long payloads are copied once, into memory that the message then lies in.
        self._long = size >= LATE_FROM
        self._make: Callable[[Any], M] = kind.from_buffer if self._long else kind.from_buffer_copy
        self._decode = kind._decode
        hot = _AtHand(
            places=tuple(_place(region, slot) for slot in range(self._slots)),
            map=region.map,
            words=region.words,
            quads=region.quads,
            acquire=None if isinstance(region.semaphore, semaphores.NoSemaphore) else region.semaphore.acquire,
            release=region.semaphore.release,
            pid=region.pid,
        )
        self._hot = cast(_AtHand, tuple(hot))
        self._last = 0 if history else max(0, self._words[COMPLETED] - 1)
        self._stamp = None
        self._missed = 0
        self._event: Any = None
        self._passive = passive
        self._polls = passive or region.options.sync == "sequence"
        self._beat = self._words[HEARTBEAT]
        self._beat_since = time.monotonic()
        self._in_c = core.IN_C and not passive
        if self._in_c:
            core.connect_reader(self, region, self._long)
        self._hold()

    def read(self) -> M | None:
        """The newest sample, or None if it has been read already (or the lock is needed and not free)."""
        number = self._words[COMPLETED]
        if number == self._last:
            return None
        data = (self._in_c and self._straight(number)) or self._newest()
        return self._make(data) if data else None

    def read_into(self, message: Any) -> bool:
        """As read(), but fills `message`, a `message_type` or any object with the same attributes; True if new."""
        if self._words[COMPLETED] == self._last:
            return False
        data = self._newest()
        if not data:
            return False
        if type(message) is self.message_type:
            ctypes.pointer(message)[0] = self._make(data)
        else:
            self._decode(data, 0, message)
        return True

    def read_all(self) -> list[M]:
        """Every unread sample not overwritten yet, the oldest first."""
        return [message for _, _, message in self.samples()]

    def samples(self) -> list[Sample[M]]:
        """The same, each as (number, stamp, message)."""
        samples: list[Sample[M]] = []
        tries = _TRIES
        while tries and not samples and (unread := self.unread):
            tries -= 1
            start = self._last
            for step in range(max(1, unread - self._slots + 1), unread + 1):
                number = after(start, step, self._slots)
                data = self._copy(number)
                if data == _LOCKED_OUT:
                    return samples
                if data is not None:
                    samples.append(Sample((number, self._stamp or 0, self._make(data))))
        return samples

    def ready(self, timeout: float) -> bool:
        """Whether there is an unread sample, as soon as there is one or after `timeout` seconds; reads nothing.

        Sleeps as wait() does. Raises PermissionDenied.
        """
        deadline = time.monotonic() + timeout
        if self._event is None:
            self._listen()
        while (newest := self._words[COMPLETED]) in (0, self._last):
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._sleep(min(left, _SLICE), newest)
        return True

    def wait(self, timeout: float) -> M | None:
        """The newest sample as soon as there is a new one, or None after `timeout` seconds.

        The writer wakes one waiting reader of a region, others poll every millisecond. Raises PermissionDenied.
        """
        deadline = time.monotonic() + timeout
        if self._event is None:
            self._listen()
        while True:
            newest = self._words[COMPLETED]
            if newest not in (0, self._last) and (data := self._copy(newest, deadline)):
                return self._make(data)
            left = deadline - time.monotonic()
            if left <= 0:
                return None
            self._sleep(min(left, _SLICE), newest)

    @property
    def topic(self) -> str:
        """As given."""
        return self._region.topic

    @property
    def sequence(self) -> int:
        """Number of the newest sample read, 0 = none yet; after 2**32 - 1 comes the number of slots."""
        return 0 if self._stamp is None else self._last

    @property
    def unread(self) -> int:
        """Samples published since the newest one read, those overwritten meanwhile too."""
        newest = self._words[COMPLETED]
        if newest in (0, self._last):
            return 0
        unread = steps(self._last, newest, self._slots)
        if unread >= _RESTART_GAP:
            self._last, unread = newest - 1, 1
        return unread

    @property
    def missed(self) -> int:
        """Samples overwritten unread: samples read and samples missed add up to samples written."""
        return self._missed

    @property
    def lock_misses(self) -> int:
        """How often the lock was not free in time."""
        return self._lock.misses

    @property
    def age(self) -> float | None:
        """Seconds since the newest sample read was written, by the wall clock; None without one or its stamp."""
        return (time.time_ns() - self._stamp) / 1e9 if self._stamp else None

    def is_stale(self, timeout: float) -> bool:
        """Whether the writer's heartbeat has not changed for `timeout` seconds, as seen by calls of this method.

        Call it in each cycle; before the first call the time counts from the opening.
        """
        beat, now = self._words[HEARTBEAT], time.monotonic()
        if beat != self._beat:
            self._beat, self._beat_since = beat, now
        return now - self._beat_since >= timeout

    def _listen(self) -> None:
        event = semaphores.NoSemaphore() if self._polls else open_event(self._region)
        self._event_at = event.handle or 0
        self._event = event

    def _sleep(self, seconds: float, newest: int) -> None:
        """Until the writer posts the event, unless `completed` has left `newest` behind already.

        A post for a sample that was read without it, or for a reader that died, ends one wait early.
        """
        if self._doze(int(seconds * 1e9), newest):
            return
        words = self._words
        if self._polls or words[ARMED]:
            # There is no event, or another reader has it. If that died waiting, the next sample clears the word.
            time.sleep(min(seconds, _POLL))
            return
        words[ARMED] = 1
        fence()
        if words[COMPLETED] != newest or not semaphores.wait(self._event, seconds) or words[ARMED]:
            words[ARMED] = 0  # still set after a post too many; left so, it would look like another reader's

    def _skip(self) -> None:
        """What is there counts as read."""
        self._last = self._words[COMPLETED]

    def _let_go(self, gone: ClosedProxy) -> None:
        self._words = cast(memoryview, gone)
        self._disconnect()
        self._lock.leave()
        self._region.close(gone)

    def _newest(self) -> bytes | bytearray | None:
        for _ in range(_TRIES):
            number = self._words[COMPLETED]
            if number in (0, self._last):
                return None
            data = self._copy(number)
            if data is not None:
                return data
        return None

    def _copy(self, number: int, deadline: float | None = None) -> bytes | bytearray | None:
        """The payload of sample `number`, None if it was overwritten, or _LOCKED_OUT."""
        data: bytes | bytearray | None
        if self._in_c and (data := self._straight(number)) is not None:
            return data
        places, map, words, quads, acquire, release, pid = self._hot
        slots = self._slots
        payload, stamp_at, number_at = places[number & slots - 1]
        try:
            inside = acquire is not None and (acquire(False) or self._lock.wait(deadline))
            if inside:
                count = words[LOCK_COUNT]
                words[LOCK_COUNT] = count + 1 if count != LAST else 0
                words[LOCK_HOLDER] = pid
            elif not self._lock.keeps_order:
                return _LOCKED_OUT
            stamp = quads[stamp_at]
            data = bytearray(memoryview(map)[payload]) if self._long else map[payload]
            # Both after the copy: a writer says what it is about to overwrite before it does, and one that has lost
            # the topic meanwhile voids the number of what it has written.
            begun = words[BEGUN]
            found = words[number_at]
            if inside:
                words[LOCK_HOLDER] = 0
                release()
        except BaseException as error:
            # However far we came: a signal handler may raise at any call above, at that of acquire() too.
            if not self._lock.leave(error):
                raise
        if found != number or steps(number, begun, slots) >= slots:
            return None
        skipped = steps(self._last, number, slots) - 1
        if 0 < skipped < _RESTART_GAP:
            self._missed += skipped
            if not self._passive:
                # Outside of the lock: of two readers that add at once one may be lost, which a figure survives.
                words[MISSED] = words[MISSED] + skipped & 0xFFFFFFFF
        self._last = number
        self._stamp = stamp
        return data


def _place(region: Region, slot: int) -> tuple[slice, int, int]:
    """Where the payload of a slot lies, its stamp in steps of eight bytes, its number in steps of four."""
    start = region.sample(slot).start // 8
    return region.payload(slot), start + STAMP, 2 * (start + NUMBER)
