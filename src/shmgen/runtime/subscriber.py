"""The subscriber of a topic: reads messages from the topic's region."""

from __future__ import annotations

import mmap
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from math import inf
from typing import Any, Generic, TypeVar

from shmgen.core import abi
from shmgen.runtime import engine
from shmgen.runtime.errors import Closed, Overwritten, RegionRetired
from shmgen.runtime.messages.in_place import InPlace
from shmgen.runtime.messages.message import Message
from shmgen.runtime.region.header import HEARTBEAT, steps
from shmgen.runtime.region.resource import Endpoint, close_after_fork, finish
from shmgen.runtime.region.settings import settings_for

M = TypeVar("M", bound=Message)
T = TypeVar("T")

_POLL = abi.POLL_MS / 1000
"""Seconds until the next try if a sample exists but cannot be read, for example because the lock is not free."""
_FOR_EVER = 3e9
"""Seconds: about a century, the longest timeout passed to the engine."""


class Sample(tuple[int, int, M]):
    """A tuple of number, stamp and message, which Subscriber.samples() yields.

    ```python
    with PoseSubscriber("/robot/pose", depth=8) as subscriber:
        subscriber.ready(timeout=1.0)
        for number, stamp, pose in subscriber.samples():
            print(number, stamp, pose.position.x)
    ```
    """

    __slots__ = ()

    @property
    def number(self) -> int:
        """The number of this sample. The first sample of a topic has number 1.

        After 2**32 - 1 the numbers restart at the number of slots.
        """
        return self[0]

    @property
    def stamp(self) -> int:
        """The time of writing in ns since 1970, or 0 if the writer has no clock."""
        return self[1]

    @property
    def message(self) -> M:
        return self[2]


class Subscriber(Endpoint, Generic[M]):
    """Read messages of one type from one topic, by `for message in subscriber` or with the methods.

    Threads may share a subscriber: each sample then goes to one thread. A forked child must open its own subscriber.

    ```python
    with PoseSubscriber("/robot/pose") as subscriber:
        if pose := subscriber.wait(timeout=1.0):
            print(pose.position.x)
    ```
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
        reopen: bool = True,
    ) -> None:
        """Open the region, or create it if the writer has not done so. See Publisher for other parameters and errors.

        The newest sample published before the opening counts as unread. With `history` all earlier samples count as
        unread, and overwritten samples count as missed.
        `passive` is for monitoring tools. A passive subscriber writes nothing to the region and does not affect
        how other readers are woken. It acquires the lock only on machines that need the lock (not x86).
        Raises RegionMissing if `passive` is set and the region does not exist.
        `spin` is the time in seconds, at most 0.001, for which a waiting call polls before each sleep. Only the engine
        in C polls. A sleeping processor takes longer to wake than most samples take to arrive.
        If the region is removed, the next calls reopen the region within 0.1 s, increment `reopen_count`, and log the
        first reopening as `shmgen`. All samples of the new region are unread. With `reopen=False`, and in a passive
        subscriber, the calls raise RegionRetired.
        """
        options = {"depth": depth, "lock_timeout": lock_timeout, "mode": mode, "group": group, "reopen": reopen}
        end = self._begin(topic, passive=passive, history=history, spin=spin, **options)
        finish([end])
        self._end = end

    def _begin(self, topic: str, **options: Any) -> Any:
        """Begin to open the region, without waiting, and return the engine's reader. finish() completes the opening."""
        kind = self.message_type
        of = settings_for("subscriber", kind, topic, codec=engine.codec(kind), **options)
        self._closing: list[Callable[[], object]] = []
        self._topic, self._slots, self._size, self._passive = topic, of.header.slots, of.header.size, of.passive
        self._map: tuple[int, mmap.mmap] | None = None
        self._beat: int | None = None
        self._beat_since = time.monotonic()
        return close_after_fork(engine.Reader(of))

    def read(self) -> M | None:
        """Return the newest sample, or None if this sample was read already.

        Also return None if this machine needs the lock (not x86) and the lock is not free in time.
        """
        message: M | None = self._end.read(None)
        return message

    def read_into(self, message: Any) -> bool:
        """Read the newest sample into `message`. Return False if there is no unread sample.

        `message` is a `message_type`, or any object with the same attributes.
        """
        return bool(self._end.read_into(message))

    @contextmanager
    def borrow(self) -> Iterator[InPlace | None]:
        """Yield the newest sample in place, without a copy, or None as in read(). For large messages.

        The sample is read-only, and its arrays of numbers are memoryviews. The writer may overwrite the sample during
        the `with` block. A `depth` of 3 or more leaves more time. Machines that need the lock (not x86) hold the lock
        until the block ends.
        Raises Overwritten at the end of the block if the writer has overwritten the sample.
        Raises Reentered if a sample is borrowed already. Raises ValueError if the subscriber is passive.
        """
        if self._passive:
            raise ValueError(f"{self._topic}: a passive subscriber cannot borrow samples; use read()")
        at = self._end.borrow()
        if at is None:
            yield None
            return
        try:
            memory = self._memory()
            yield InPlace(self.message_type.from_buffer(memory, at), memory, at)
        except BaseException as error:
            if self._end.give_back() or not isinstance(error, Exception):
                raise
            raise self._overwritten_error() from error
        if not self._end.give_back():
            raise self._overwritten_error()

    def _memory(self) -> mmap.mmap:
        """Return a memory map of the region. The region is mapped once, and again after it was reopened."""
        count = self._end.reopen_count
        if self._map is None or self._map[0] != count:
            self._map = count, close_after_fork(mmap.mmap(self._end.file, self._size))
        return self._map[1]

    def _overwritten_error(self) -> Overwritten:
        return Overwritten(f"{self._topic}: the sample was overwritten during an in-place read; read the newest sample")

    def read_all(self) -> list[M]:
        """Return all unread samples that are not overwritten yet, the oldest first."""
        return [message for _, _, message in self.samples()]

    def samples(self) -> list[Sample[M]]:
        """Return all unread samples that are not overwritten yet, as (number, stamp, message), the oldest first."""
        end = self._end
        samples: list[Sample[M]] = []
        try:
            while len(samples) < self._slots and (message := end.next()) is not None:
                samples.append(Sample((end.sequence, end.stamp, message)))
        except RegionRetired:
            if not samples:  # otherwise the next call raises it
                raise
        return samples

    def ready(self, timeout: float) -> bool:
        """Return True as soon as there is an unread sample, or False after `timeout` seconds. Read nothing.

        The writer wakes all waiting readers.
        Raises PermissionDenied if this user may not open the semaphore that wakes readers.
        """
        return bool(self._end.ready(_ns(_check_timeout(timeout))))

    def wait(self, timeout: float) -> M | None:
        """Return the newest unread sample as soon as there is one, or None after `timeout` seconds.

        The writer wakes all waiting readers.
        Raises PermissionDenied if this user may not open the semaphore that wakes readers.
        """
        deadline = time.monotonic() + _check_timeout(timeout)
        while self._end.ready(_ns(deadline - time.monotonic())):
            message: M | None = self._end.read(_ns(deadline - time.monotonic()))
            if message is not None or (left := deadline - time.monotonic()) <= 0:
                return message
            time.sleep(min(left, _POLL))
        return None

    def __iter__(self) -> Iterator[M]:
        """Yield the newest sample each time a new sample arrives, until the subscriber is closed."""
        try:
            while True:
                if (message := self.wait(1.0)) is not None:
                    yield message
        except Closed:
            return

    async def wait_async(self, timeout: float) -> M | None:
        """Return the newest unread sample as soon as there is one, or None after `timeout` seconds. For coroutines.

        One thread for each event loop waits on behalf of all coroutines.
        """
        return await self._poll_until_found(self.read, _check_timeout(timeout))

    async def ready_async(self, timeout: float) -> bool:
        """Return True as soon as there is an unread sample, or False after `timeout` seconds. For coroutines.

        Read nothing, so that read_all() can then return all unread samples.
        """
        return await self._poll_until_found(lambda: self.ready(0.0) or None, _check_timeout(timeout)) is not None

    async def _poll_until_found(self, poll: Callable[[], T | None], timeout: float, interval: float = inf) -> T | None:
        """Return the first result of `poll` that is not None, as poll_until_found() in event_loop.py does."""
        from shmgen.runtime.event_loop import poll_until_found  # asyncio takes longer to load than the runtime

        return await poll_until_found(poll, self, timeout, interval)

    async def __aiter__(self) -> AsyncIterator[M]:
        """Yield the newest sample each time a new sample arrives, until the subscriber is closed. For `async for`."""
        try:
            while True:
                if (message := await self.wait_async(1.0)) is not None:
                    yield message
        except Closed:
            return

    def close(self) -> None:
        """Close the region, which stays unchanged. Waiting calls in other threads raise Closed."""
        super().close()
        while self._closing:
            self._closing.pop()()

    @property
    def sequence(self) -> int:
        """The number of the newest sample that was read, or 0 before the first.

        After 2**32 - 1 the numbers restart at the number of slots.
        """
        return int(self._end.sequence)

    @property
    def unread(self) -> int:
        """The number of samples published since the newest sample that was read, including overwritten samples."""
        newest, last = self._end.newest(), self._end.last
        if newest in (0, last):
            return 0
        unread = steps(last, newest, self._slots)
        return unread if unread < abi.RESTART_GAP else 1  # the region was recreated: its numbers start at 1

    @property
    def missed(self) -> int:
        """The number of samples that were overwritten before they were read.

        Samples read and samples missed add up to samples written.
        """
        return int(self._end.missed)

    @property
    def age(self) -> float | None:
        """The age in seconds, by the wall clock, of the newest sample that was read.

        The age is None if no sample was read, or if the sample has no stamp.
        """
        return (time.time_ns() - self._end.stamp) / 1e9 if self._end.stamp else None

    def is_stale(self, timeout: float) -> bool:
        """Return True if the writer's heartbeat has not changed for `timeout` seconds between calls of this method.

        Call this method in each cycle. Before the first call, the time counts from the opening of the subscriber.
        """
        beat, now = self._end.load(HEARTBEAT), time.monotonic()
        if beat != (self._end.beat if self._beat is None else self._beat):
            self._beat_since = now
        self._beat = beat
        stale = now - self._beat_since >= timeout
        if stale:
            self._end.check()
        return stale

    def _on_close(self, work: Callable[[], object]) -> None:
        """Register `work`, a function to call when this subscriber is closed, after its reader is closed."""
        self._closing.append(work)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._topic!r}, sequence={self.sequence}, missed={self.missed})"


def _check_timeout(timeout: float) -> float:
    if isinstance(timeout, str) or not hasattr(timeout, "__float__"):
        raise TypeError(f"timeout must be a number of seconds, not {timeout!r:.40} ({type(timeout).__name__})")
    return timeout


def _ns(seconds: float) -> int:
    return int(max(0.0, min(seconds, _FOR_EVER)) * 1e9)
