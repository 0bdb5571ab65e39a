"""Turns messages into samples of a topic's region, one writer for each topic."""

from __future__ import annotations

import ctypes
import mmap
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Generic, NamedTuple, NoReturn, TypeVar, cast

from shmgen.runtime import core
from shmgen.runtime.errors import ClaimLost, LockTimeout
from shmgen.runtime.messages.message import CUT, LATE_FROM, Late, Message
from shmgen.runtime.region import header as h
from shmgen.runtime.region.claim import claim, writer
from shmgen.runtime.region.header import (
    ARMED,
    BEGUN,
    COMPLETED,
    HEARTBEAT,
    LAST,
    LOCK_COUNT,
    LOCK_HOLDER,
    NUMBER,
    SLOT_HEADER,
    STAMP,
    WRITER,
)
from shmgen.runtime.region.lock import UNTIL_RECOVERED, Lock
from shmgen.runtime.region.memory_order import fence
from shmgen.runtime.region.opening import open_event, open_region
from shmgen.runtime.region.region import WRITER_LOCK
from shmgen.runtime.region.resource import ClosedProxy, RegionHolder

M = TypeVar("M", bound=Message)

_IN_C = core.IN_C
"""Here, where Python finds it in 3 ns, and in 20 on the object."""


class _AtHand(NamedTuple):
    """What publish() needs. It is kept as a plain tuple, which is taken apart 40 ns faster than a named one."""

    kind: Any
    encode: Callable[[Any, bytearray, int, Late], None]
    scratch: bytearray
    late: Late
    head: memoryview
    clock: Callable[[], int]
    samples: tuple[slice, ...]
    mask: int
    map: mmap.mmap
    words: memoryview
    acquire: Callable[[bool], bool]
    release: Callable[[], None]
    pid: int


class Publisher(RegionHolder, core.Writer, Generic[M]):
    """Publishes one type on one topic. Not for two threads at a time; forked children open their own."""

    message_type: type[M]
    _word = "publisher"
    _lock: Lock

    def __init__(
        self,
        topic: str,
        *,
        depth: int = 1,
        lock_timeout: float | None = None,
        mode: int | None = None,
        group: str | int | None = None,
    ) -> None:
        """Opens the region or creates it, and claims it, which takes a second where a PLC was the writer before.

        `depth` is how many samples a slow reader can still fetch, the same on both sides. `lock_timeout`, in
        seconds, is the longest a call waits for the lock; None: 0.01, and where the lock is needed (not on x86) until
        its holder releases it or is considered dead, 1.1 at most. `mode` (0o660) and `group` are for files created
        here, or found and owned by this user; left out they are those of shmgen.toml, if it has any.
        Raises ValueError (topic, depth, lock_timeout), LayoutMismatch, RegionInUse, PermissionDenied,
        RegionUnusable, LockTimeout.
        """
        kind = self.message_type
        size = ctypes.sizeof(kind)
        ours = h.header_for(kind._type_name_, kind._digest_, size, depth)
        self._region = region = open_region(topic, ours, kind._regions_.but(mode, group))
        try:
            self._lock = Lock(region, lock_timeout, UNTIL_RECOVERED)
            self._deadline: float | None = None
            self._event = open_event(region)
            self._sequence, self._claim_doubtful = claim(region)
        except BaseException:
            region.close()
            raise
        self._scratch = bytearray(SLOT_HEADER + size)
        self._heartbeat: int = region.words[HEARTBEAT]
        self._truncations = 0
        self._words: memoryview | ClosedProxy = region.words
        hot = _AtHand(
            kind=kind,
            encode=kind._encode,
            scratch=self._scratch,
            late=[],
            head=memoryview(self._scratch)[:SLOT_HEADER].cast("Q"),
            clock=time.time_ns,
            samples=tuple(region.sample(slot) for slot in range(region.header.slots)),
            mask=region.header.slots - 1,
            map=region.map,
            words=region.words,
            acquire=region.semaphore.acquire,
            release=region.semaphore.release,
            pid=region.pid,
        )
        self._hot = cast(_AtHand, tuple(hot))
        self._scratch_message = (kind * 1).from_buffer(self._scratch, SLOT_HEADER)
        message = self._scratch_message if len(self._scratch) < LATE_FROM else None
        core.connect_writer(self, region, self._event, self._scratch, kind, message)
        self._hold()

    def publish(self, message: Any) -> None:
        """Writes `message`: a `message_type`, or any object with the same attributes.

        Raises ValueRejected, with the path of the field, for a value that does not fit, and LockTimeout
        where the lock is needed; the region then still holds the former sample. ClaimLost: another writer has taken
        the topic over, and nothing more will be published here.
        """
        if _IN_C and self._at_once(message):
            return
        kind, encode, scratch, late, head, clock, samples, mask, map, words, acquire, release, pid = self._hot
        try:
            if type(message) is not kind:
                encode(message, scratch, SLOT_HEADER, late)
            elif len(scratch) < LATE_FROM:
                self._scratch_message[0] = message
            else:
                late.append((SLOT_HEADER, len(scratch) - SLOT_HEADER, memoryview(message)))
            if _IN_C and (self._with_late(late) if late else self._straight()):
                late.clear()
                return
            number = self._sequence + 1
            if number > LAST:
                number = mask + 1
            sample = samples[number & mask]
            parts = self._parts(sample.start, late) if late else None
            head[STAMP] = clock()
            head[NUMBER] = number
            # A comparison costs less than a mask of 32 bits, which Python holds in two digits.
            beat = self._heartbeat
            beat = beat + 1 if beat != LAST else 0
            inside = acquire(False) or self._wait()
            if words[WRITER] != pid:
                self._lose()
            words[HEARTBEAT] = beat
            if inside:
                count = words[LOCK_COUNT]
                words[LOCK_COUNT] = count + 1 if count != LAST else 0
                words[LOCK_HOLDER] = pid
            words[BEGUN] = number
            if parts is None:
                map[sample] = scratch
            else:
                self._copy(parts)
            if words[WRITER] != pid:
                self._void(sample)
            # From here on the number is used up, whatever a signal handler raises.
            self._sequence = number
            self._heartbeat = beat
            words[COMPLETED] = number
            if inside:
                words[LOCK_HOLDER] = 0
                release()
        except BaseException as error:
            # However far we came: a signal handler may raise at any call above, at that of acquire() too.
            late.clear()
            if not self._lock.leave(error):
                raise
        if words[ARMED] or not inside:
            self._attend(words, inside)

    def _publish_by(self, message: Any, deadline: float | None) -> None:
        """As publish(), with the lock's time limit that of a call that ends then, by time.monotonic()."""
        self._deadline = deadline
        try:
            self.publish(message)
        finally:
            self._deadline = None

    def heartbeat(self) -> None:
        """Shows readers that the writer is alive, without a sample. Raises ClaimLost."""
        self._assure()
        self._heartbeat = self._heartbeat + 1 & LAST
        self._words[HEARTBEAT] = self._heartbeat

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
        """How many strings publish() has cut; always 0 unless `overflow = "truncate"` in shmgen.toml."""
        return self._truncations

    def _parts(self, start: int, late: Late) -> list[tuple[slice, memoryview]] | None:
        """The sample as copies to make: the late arrays, and scratch where none of them has its room."""
        arrays = [found for found in late if found is not CUT]
        self._truncations += len(late) - len(arrays)
        late.clear()
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
        if words[ARMED]:
            words[ARMED] = 0
            with suppress(ValueError):  # one post is there already, and enough
                self._event.release()

    def _wait(self) -> bool:
        if self._lock.wait(self._deadline):
            return True
        if not self._lock.keeps_order:
            raise LockTimeout(
                f"{self.topic}: the lock was not free in time, held by process {self._region.words[LOCK_HOLDER]}; "
                "nothing was published. See `shmgen doctor`"
            )
        return False

    def _assure(self) -> None:
        """Raises ClaimLost unless the topic is still this publisher's."""
        if self._words[WRITER] != self._region.pid:
            self._lose()

    def _void(self, sample: slice) -> NoReturn:
        """What lies in the slot may be of two writers."""
        self._region.words[sample.start // 4 + 2 * NUMBER] = 0
        self._lose()

    def _lose(self) -> NoReturn:
        """Leaves the topic to the writer who has claimed it: this one stood still for a second, or seemed to."""
        gone = ClosedProxy(
            ClaimLost, f"{self.topic}: {writer(self._region)} has taken the topic over; nothing was published"
        )
        self._stop(gone)
        self._region.unlock_byte(WRITER_LOCK)
        gone()

    def _stop(self, gone: ClosedProxy) -> None:
        """From now on publish() and heartbeat() raise that."""
        self._disconnect()
        # No message is of the type Message, so publish() goes on to encode it.
        self._hot = cast(_AtHand, (Message, gone, *self._hot[2:]))
        self._words = gone

    def _let_go(self, gone: ClosedProxy) -> None:
        self._stop(gone)
        self._lock.leave()
        self._region.close(gone)
