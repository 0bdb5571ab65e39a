"""Turns messages into samples of a topic's region, one writer a topic."""

from __future__ import annotations

import ctypes
import os
import time
from typing import Any, Generic, NoReturn, TypeVar

from shmgen import abi
from shmgen.runtime import header as h
from shmgen.runtime.closing import Closing
from shmgen.runtime.errors import LockTimeout, RegionInUse, ShmError
from shmgen.runtime.header import (
    BEGUN,
    COMPLETED,
    HEARTBEAT,
    LAST,
    LOCK_COUNT,
    LOCK_HOLDER,
    NUMBER,
    RECOVERIES_ARMED,
    SLOT_HEADER,
    STAMP,
)
from shmgen.runtime.lock import LOCK_TIMEOUT, Lock, fence
from shmgen.runtime.message import CUT, LATE_FROM, Late, Message
from shmgen.runtime.region import WRITER_LOCK, Region, open_event, open_region

M = TypeVar("M", bound=Message)

_PLC_WATCH = abi.PLC_WATCH_MS / 1000
"""Seconds within which a PLC that still runs counts its heartbeat up."""


class Publisher(Closing, Generic[M]):
    """Publishes one type on one topic. Not for two threads at a time; forked children open their own."""

    message_type: type[M]

    def __init__(
        self,
        topic: str,
        *,
        depth: int = 1,
        lock_timeout: float = LOCK_TIMEOUT,
        mode: int | None = None,
        group: str | int | None = None,
    ) -> None:
        """Opens the region or makes it, and claims it.

        `depth` is how many samples a slow reader can still fetch, the same on both sides. `lock_timeout`,
        in seconds, is the longest a call waits for the lock. `mode` (0o660) and `group` are for
        files made here, or found and this user's; left out they are what shmgen.toml said, if it said anything.
        Raises ValueError (topic, depth, lock_timeout), LayoutMismatch, RegionInUse, PermissionDenied,
        RegionUnusable.
        """
        kind = self.message_type
        size = ctypes.sizeof(kind)
        ours = h.header_for(kind._type_name_, kind._digest_, size, depth)
        self._region = region = open_region(topic, ours, kind._regions_.but(mode, group))
        try:
            self._lock = Lock(region, lock_timeout)
            self._event = open_event(region)
            _claim(region)
        except BaseException:
            region.close()
            raise
        self._scratch = bytearray(SLOT_HEADER + size)
        self._sequence: int = region.words[h.COMPLETED]
        self._heartbeat: int = region.words[h.HEARTBEAT]
        self._truncations = 0
        # What publish() needs, in one look.
        self._hot: tuple[Any, ...] = (
            kind,
            kind._encode,
            self._scratch,
            memoryview(self._scratch)[:SLOT_HEADER].cast("Q"),
            time.time_ns,
            tuple(region.sample(slot) for slot in range(region.header.slots)),
            region.header.slots - 1,
            region.map,
            region.words,
            region.quads,
            region.semaphore.acquire,
            region.semaphore.release,
            os.getpid(),
        )
        self._scratch_message = (kind * 1).from_buffer(self._scratch, SLOT_HEADER)

    def publish(self, message: Any) -> None:
        """Writes `message`: a `message_type`, or any object with the same attributes.

        Raises ValueRejected, with the path of the field, for a value that does not fit, and LockTimeout
        where the lock is needed; the region then still holds the former sample.
        """
        kind, encode, scratch, head, clock, samples, mask, map, words, quads, acquire, release, pid = self._hot
        late: Late = []
        if type(message) is not kind:
            encode(message, scratch, SLOT_HEADER, late)
        elif len(scratch) < LATE_FROM:
            self._scratch_message[0] = message
        else:
            late.append((SLOT_HEADER, len(scratch) - SLOT_HEADER, memoryview(message)))
        number = self._sequence + 1
        if number > LAST:
            number = mask + 1
        sample = samples[number & mask]
        parts = self._parts(sample.start, late) if late else None
        head[STAMP] = clock()
        head[NUMBER] = number
        # A comparison costs less than a mask of 32 bits, which Python holds in two digits.
        beat = self._heartbeat
        beat = beat + 1 if beat != 0xFFFFFFFF else 0
        inside = acquire(False) or self._wait()
        try:
            words[HEARTBEAT] = beat
            if inside:
                words[LOCK_HOLDER] = pid
                count = words[LOCK_COUNT]
                words[LOCK_COUNT] = count + 1 if count != 0xFFFFFFFF else 0
            words[BEGUN] = number
            if parts is None:
                map[sample] = scratch
            else:
                self._copy(parts)
            words[COMPLETED] = number
            self._sequence = number
            self._heartbeat = beat
        finally:
            if inside:
                words[LOCK_HOLDER] = 0
                release()
        if quads[RECOVERIES_ARMED] or not inside:
            self._attend(words, inside)

    def heartbeat(self) -> None:
        """Tells readers that the writer lives, without a sample."""
        self._heartbeat = self._heartbeat + 1 & 0xFFFFFFFF
        self._region.words[h.HEARTBEAT] = self._heartbeat

    def close(self) -> None:
        """Gives the topic free for another writer; the region and its last sample stay."""
        self._hot = (Message, _closed, *self._hot[2:])
        self._region.close()

    @property
    def topic(self) -> str:
        """As given."""
        return self._region.topic

    @property
    def sequence(self) -> int:
        """Number of the newest sample, 0 = none yet; after 2**32 - 1 comes the number of slots."""
        return self._sequence

    @property
    def lock_misses(self) -> int:
        """How often the lock was not free in time."""
        return self._lock.misses

    @property
    def truncations(self) -> int:
        """How many texts publish() has cut; always 0 unless `overflow = "truncate"` in shmgen.toml."""
        return self._truncations

    def _parts(self, start: int, late: Late) -> list[tuple[slice, memoryview]] | None:
        """The sample as copies to make: the late arrays, and scratch where none of them has its room."""
        arrays = [found for found in late if found is not CUT]
        self._truncations += len(late) - len(arrays)
        if not arrays:
            return None
        view = memoryview(self._scratch)
        parts: list[tuple[slice, memoryview]] = []
        done = 0
        for offset, room, data in arrays:
            if offset > done:
                parts.append((slice(start + done, start + offset), view[done:offset]))
            if data.nbytes:
                parts.append((slice(start + offset, start + offset + data.nbytes), data))
            done = offset + room
        if done < len(view):
            parts.append((slice(start + done, start + len(view)), view[done:]))
        return parts

    def _copy(self, parts: list[tuple[slice, memoryview]]) -> None:
        # memcpy may use streaming stores, which pass earlier ones even on x86-64; a locked instruction,
        # such as taking any mutex, keeps them behind `begun`.
        fence()
        for where, what in parts:
            self._region.map[where] = what

    def _attend(self, words: memoryview, inside: bool) -> None:
        """Wakes a waiting reader. The release of the lock keeps the look at `armed` behind `completed`."""
        if not inside:
            fence()
        if words[h.ARMED]:
            words[h.ARMED] = 0
            self._event.release()
        if words[h.RECOVERIES]:
            self._lock.take_surplus()

    def _wait(self) -> bool:
        if self._lock.wait():
            return True
        if not self._lock.keeps_order:
            raise LockTimeout(
                f"{self.topic}: the lock was not free within {self._lock.timeout} s, held by process "
                f"{self._region.words[h.LOCK_HOLDER]}; nothing was published. See `shmgen doctor`"
            )
        return False


def _claim(region: Region) -> None:
    claimed = region.lock_byte(WRITER_LOCK)
    writer = region.words[h.WRITER]
    if not claimed:
        raise RegionInUse(
            f"{region.topic}: process {writer} publishes already; one writer a topic: stop that one first"
        )
    if writer == h.PLC and _beats(region):
        raise RegionInUse(
            f"{region.topic}: a PLC publishes already; one writer a topic: stop its publisher block first"
        )
    region.words[h.WRITER] = os.getpid()


def _beats(region: Region) -> bool:
    before = region.words[h.HEARTBEAT]
    deadline = time.monotonic() + _PLC_WATCH
    while time.monotonic() < deadline:
        if region.words[h.HEARTBEAT] != before:
            return True
        time.sleep(0.002)
    return False


def _closed(*_: object) -> NoReturn:
    raise ShmError("this publisher is closed")
