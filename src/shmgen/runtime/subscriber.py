"""The subscriber of a topic: reads messages from its region."""

from __future__ import annotations

import mmap
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Any, Generic

from shmgen.core import abi
from shmgen.runtime import engine
from shmgen.runtime.errors import Closed, Overwritten, RegionRetired
from shmgen.runtime.messages.in_place import InPlace
from shmgen.runtime.region.header import HEARTBEAT, steps
from shmgen.runtime.region.resource import Closable, finish, kept_from_children
from shmgen.runtime.region.settings import settings_for
from shmgen.runtime.sample import M, Sample

_POLL = abi.POLL_MS / 1000
"""Seconds after which a sample is tried again that is there and cannot be had."""
_FOR_EVER = 3e9
"""Seconds: a century."""
_AWHILE = 0.1
"""Seconds for which a thread sleeps that waits for a coroutine."""


class Subscriber(Closable, Generic[M]):
    """Reads one type from one topic: `for message in subscriber`, or one of its calls. Forked children open their own.

    Threads may share it: each sample then goes to one of them.
    """

    message_type: type[M]

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
        spin: float = 0.0,
    ) -> None:
        """Opens the region, or creates it if the writer has not yet; parameters and errors as for a publisher.

        The newest sample published before counts as unread; with `history` all of them do, as missed if they were
        overwritten. `passive` is for tools that watch: the region must be there (RegionMissing), nothing is written
        to it, nobody is kept from being woken, and only where the lock keeps the order (not on x86) it is taken.
        Who waits looks for `spin` seconds before each sleep, 0.001 at most (in C): for a processor that
        has slept takes longer to wake than most samples take to come.
        """
        options = {"depth": depth, "lock_timeout": lock_timeout, "mode": mode, "group": group}
        end = self._begin(topic, passive=passive, history=history, spin=spin, **options)
        finish([end])
        self._end = end

    def _begin(self, topic: str, **options: Any) -> Any:
        """Begins to open it: see open_all()."""
        kind = self.message_type
        of = settings_for("subscriber", kind, topic, codec=engine.codec(kind), **options)
        self._topic, self._slots, self._size, self._passive = topic, of.header.slots, of.header.size, of.passive
        self._map: mmap.mmap | None = None
        self._beat: int | None = None
        self._beat_since = time.monotonic()
        return kept_from_children(engine.Reader(of))

    def read(self) -> M | None:
        """The newest sample, or None if it has been read already (or the lock is needed and not free)."""
        message: M | None = self._end.read(None)
        return message

    def read_into(self, message: Any) -> bool:
        """As read(), but fills `message`, a `message_type` or any object with the same attributes; True if new."""
        return bool(self._end.read_into(message))

    @contextmanager
    def borrow(self) -> Iterator[InPlace | None]:
        """The newest sample where it lies, for a `with`, or None as for read(): for messages that take long to copy.

        It is read-only, arrays of numbers as memoryviews. The writer may overwrite it meanwhile, and at the end of the
        `with` what was read either counts or raises Overwritten. A `depth` of 3 or more leaves more time. Where the
        lock is needed (not on x86) it is held. Reentered: one is borrowed already. ValueError: passive ones copy.
        """
        if self._passive:
            raise ValueError(f"{self._topic}: a passive subscriber reads copies; use read()")
        at = self._end.borrow()
        if at is None:
            yield None
            return
        try:
            if self._map is None:
                self._map = kept_from_children(mmap.mmap(self._end.file, self._size))
            yield InPlace(self.message_type.from_buffer(self._map, at), self._map, at)
        except BaseException as error:
            if self._end.give_back() or not isinstance(error, Exception):
                raise
            raise self._overwritten() from error
        if not self._end.give_back():
            raise self._overwritten()

    def _overwritten(self) -> Overwritten:
        return Overwritten(f"{self._topic}: the sample was overwritten while it was read in place; read the newest")

    def read_all(self) -> list[M]:
        """Every unread sample not overwritten yet, the oldest first."""
        return [message for _, _, message in self.samples()]

    def samples(self) -> list[Sample[M]]:
        """The same, each as (number, stamp, message)."""
        end = self._end
        samples: list[Sample[M]] = []
        try:
            while len(samples) < self._slots and (message := end.next()) is not None:
                samples.append(Sample((end.sequence, end.stamp, message)))
        except RegionRetired:
            if not samples:  # else the next call says so
                raise
        return samples

    def ready(self, timeout: float) -> bool:
        """Whether there is an unread sample, as soon as there is one or after `timeout` seconds; reads nothing.

        Sleeps as wait() does. Raises PermissionDenied.
        """
        return bool(self._end.ready(_ns(timeout)))

    def wait(self, timeout: float) -> M | None:
        """The newest sample as soon as there is a new one, or None after `timeout` seconds.

        The writer wakes all that wait. Raises PermissionDenied.
        """
        deadline = time.monotonic() + timeout
        while self._end.ready(_ns(deadline - time.monotonic())):
            message: M | None = self._end.read(_ns(deadline - time.monotonic()))
            if message is not None or (left := deadline - time.monotonic()) <= 0:
                return message
            time.sleep(min(left, _POLL))
        return None

    def __iter__(self) -> Iterator[M]:
        """The newest sample each time there is a new one, until the subscriber is closed."""
        try:
            while True:
                if (message := self.wait(1.0)) is not None:
                    yield message
        except Closed:
            return

    async def wait_async(self, timeout: float) -> M | None:
        """As wait(), for coroutines: a thread of the event loop's executor sleeps."""
        import asyncio  # takes longer to load than the rest of the runtime

        loop, deadline = asyncio.get_running_loop(), time.monotonic() + timeout
        while (message := self.read()) is None and (left := deadline - time.monotonic()) > 0:
            await loop.run_in_executor(None, self.ready, min(left, _AWHILE))
        return message

    async def __aiter__(self) -> AsyncIterator[M]:
        """`async for message in subscriber`, until it is closed."""
        try:
            while True:
                if (message := await self.wait_async(1.0)) is not None:
                    yield message
        except Closed:
            return

    def close(self) -> None:
        """Closes the region, which stays as it is. Who waits in another thread is told: Closed."""
        self._end.close()

    @property
    def topic(self) -> str:
        """As given."""
        return self._topic

    @property
    def sequence(self) -> int:
        """Number of the newest sample read, 0 = none yet; after 2**32 - 1 comes the number of slots."""
        return int(self._end.sequence)

    @property
    def unread(self) -> int:
        """Samples published since the newest one read, those overwritten meanwhile too."""
        newest, last = self._end.newest(), self._end.last
        if newest in (0, last):
            return 0
        unread = steps(last, newest, self._slots)
        return unread if unread < abi.RESTART_GAP else 1  # the region was begun anew and counts from 1 again

    @property
    def missed(self) -> int:
        """Samples overwritten unread: samples read and samples missed add up to samples written."""
        return int(self._end.missed)

    @property
    def lock_misses(self) -> int:
        """How often the lock was not free in time."""
        return int(self._end.lock_misses)

    @property
    def age(self) -> float | None:
        """Seconds since the newest sample read was written, by the wall clock; None without one or its stamp."""
        return (time.time_ns() - self._end.stamp) / 1e9 if self._end.stamp else None

    def is_stale(self, timeout: float) -> bool:
        """Whether the writer's heartbeat has not changed for `timeout` seconds, as seen by calls of this method.

        Call it in each cycle; before the first call the time counts from the opening.
        """
        beat, now = self._end.load(HEARTBEAT), time.monotonic()
        if beat != (self._end.beat if self._beat is None else self._beat):
            self._beat_since = now
        self._beat = beat
        stale = now - self._beat_since >= timeout
        if stale:
            self._end.is_removed()
        return stale

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._topic!r}, sequence={self.sequence}, missed={self.missed})"


def _ns(seconds: float) -> int:
    return int(max(0.0, min(seconds, _FOR_EVER)) * 1e9)
