"""Waits for new samples of many subscribers at once, also in event loops, and opens many topics concurrently."""

from __future__ import annotations

import time
import weakref
from collections.abc import Iterable
from typing import Any, TypeVar

from shmgen.core import abi
from shmgen.runtime import engine
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.header import RETIRED
from shmgen.runtime.region.resource import Closable, close_after_fork, finish
from shmgen.runtime.subscriber import Subscriber

E = TypeVar("E", bound="Publisher[Any] | Subscriber[Any]")
S = TypeVar("S", bound=Subscriber[Any])

_SLICE = abi.WAKE_MS / 1000
"""Seconds of the longest single sleep. A lost wake-up delays a sample by at most this time."""


def open_all(pairs: Iterable[tuple[type[E], str]], **options: Any) -> list[E]:
    """Open all pairs of (class, topic) concurrently and return the opened publishers and subscribers in order.

    The call takes as long as the slowest opening. `options` are the keyword arguments of each class.
    If a publisher or subscriber cannot be opened, close all of them and raise the error of the first such opening.
    """
    begun: list[tuple[E, Any]] = []
    try:
        for kind, topic in pairs:
            side = kind.__new__(kind)
            begun.append((side, side._begin(topic, **options)))
        finish([end for _, end in begun])
    except BaseException:
        for _, end in begun:
            end.close()
        raise
    for side, end in begun:
        side._end = end
    return [side for side, _ in begun]


def can_wait_for_many() -> bool:
    """Return True if ready_any() with several subscribers sleeps until a writer wakes it, and False if it polls.

    Such a sleep needs a 64-bit process with the extension in C, glibc, and a permitted futex_waitv(2) (Linux 5.16). If
    it polls, ready_any() checks the subscribers every 1 ms.
    """
    return bool(engine.can_wait_for_many())


def ready_any(subscribers: Iterable[S], timeout: float) -> list[S]:
    """Return the subscribers with an unread sample as soon as there is one, or `[]` after `timeout` seconds.

    Read nothing. The result includes each subscriber whose region was removed or replaced: its next read reopens the
    region or raises the error. Only one thread at a time may wait for the same subscribers.
    Beyond the kernel's limit (64 topics from PLCs or 128 topics from other programs) the function polls every 1 ms.
    Raises the errors of Subscriber.ready().
    """
    several = tuple(subscribers)
    if len(several) == 1:
        return list(several) if several[0].ready(timeout) else []
    deadline = time.monotonic() + timeout
    ends = tuple(one.engine_end for one in several)
    while not (ready := [one for one in several if _has_news(one.engine_end)]):
        left = deadline - time.monotonic()
        if left <= 0:
            break
        engine.sleep_any(ends, int(min(left, _SLICE) * 1e9))
    return ready


class Notifier(Closable):
    """Watch subscribers, clients and servers in one thread, for an event loop (epoll, select, asyncio, Qt).

    Wait until the descriptor fileno() is readable, then call ready(). A forked child must create its own notifier.

    ```python
    with PoseSubscriber("/robot/pose") as subscriber, Notifier([subscriber]) as notifier:
        select.select([notifier], [], [], 1.0)
        for changed in notifier.ready():
            print(changed.read())
    ```
    """

    def __init__(self, ends: Iterable[Any] = ()) -> None:
        """Start the thread and watch `ends`, which are subscribers, clients and servers.

        Raises OSError if no file descriptor or thread is available.
        """
        self._notifier: Any = close_after_fork(engine.Notifier())
        self._ends: dict[Any, Any] = {}
        weakref.finalize(self, self._notifier.close)
        for end in ends:
            self.add(end)

    def add(self, end: Any) -> None:
        """Watch `end`, a subscriber, a client or a server: report new samples, responses or requests.

        A sample that is already unread counts as new. Raises Closed if `end` is closed.
        """
        reader = end.engine_end
        self._notifier.add(reader)
        self._ends[reader] = end

    def remove(self, end: Any) -> None:
        """Stop watching `end`. Call this method before you close `end`."""
        if self._ends.pop(end.engine_end, None) is not None:
            self._notifier.remove(end.engine_end)

    def ready(self) -> list[Any]:
        """Return the watched objects with a new sample since the last call.

        Read each object until it has no new sample. If an object's region was removed, the object is
        returned every 100 ms until the region is open again.
        """
        return [self._ends[reader] for reader in self._notifier.ready() if reader in self._ends]

    def fileno(self) -> int:
        """Return the file descriptor, or -1 after close()."""
        return int(self._notifier.fileno())

    def close(self) -> None:
        """Stop the thread. The watched objects stay open."""
        self._notifier.close()
        self._ends.clear()


def _has_news(end: Any) -> bool:
    return end.newest() not in (0, end.last) or bool(end.load(RETIRED))
