"""The base classes of publishers, subscribers, clients and servers: open concurrently, close, close after a fork."""

from __future__ import annotations

import os
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from functools import partial
from types import TracebackType
from typing import Any, TypeVar

from shmgen.core import abi

C = TypeVar("C", bound="Closable")
OpenRegion = Callable[[Any, str], Any]
"""Opens one region of a service or an action, given a publisher or subscriber class and the suffix of the name."""
_LOOK = abi.POLL_MS / 1000
"""Seconds between two checks for a peer while a region is being opened."""


class Closable(ABC):
    """The base class of publishers, subscribers, clients and servers."""

    @abstractmethod
    def close(self) -> None:
        """Close the regions, without removing the regions from /dev/shm."""

    def __enter__(self: C) -> C:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Endpoint(Closable):
    """The base class of publishers and subscribers: one end of a topic's region."""

    _topic: str
    _end: Any

    @property
    def engine_end(self) -> Any:
        """The writer or reader of the engine, the code in C or Python that accesses the region."""
        return self._end

    def close(self) -> None:
        """Close this publisher or subscriber. The region stays in /dev/shm, and another writer can claim its topic."""
        self._end.close()

    @property
    def topic(self) -> str:
        """The name of the topic."""
        return self._topic

    @property
    def lock_misses(self) -> int:
        """The number of times that the lock was not free in time."""
        return int(self._end.lock_misses)

    @property
    def reopen_count(self) -> int:
        """The number of times that the region was removed and reopened."""
        return int(self._end.reopen_count)


class CallEnd(Closable):
    """The base class of clients and servers: opens all regions of a service or an action, or none."""

    _calls: Any

    def __init__(
        self,
        name: str,
        *,
        lock_timeout: float | None = None,
        mode: int | None = None,
        group: str | int | None = None,
        spin: float = 0.0,
        reopen: bool = True,
    ) -> None:
        """Open or create the regions. A service or an action has one client and one server, started in any order.

        A server skips requests that are already pending.
        See Subscriber for `lock_timeout` (seconds), `mode`, `group`, `spin` and `reopen`.
        Raises ValueError, LayoutMismatch, RegionInUse, PermissionDenied and RegionUnusable as Publisher does.
        """
        options: dict[str, Any] = {"lock_timeout": lock_timeout, "mode": mode, "group": group, "reopen": reopen}
        regions: list[Endpoint] = []

        def open_part(kind: Any, part: str, **more: Any) -> Any:
            regions.append(opened.enter_context(kind(f"{name}-{part}", **options, **more)))
            return regions[-1]

        with ExitStack() as opened:
            self._open(open_part, partial(open_part, spin=spin))
            opened.pop_all()
        self._name, self._regions = name, regions

    @abstractmethod
    def _open(self, write: OpenRegion, read: OpenRegion) -> None:
        """Open each region of the service or action: `write` opens a publisher, `read` opens a subscriber."""

    def close(self) -> None:
        """Close this client or server. Another process can then open its own. The regions stay in /dev/shm."""
        for region in self._regions:
            region.close()

    @property
    def reopen_count(self) -> int:
        """The number of times that a region was removed and reopened."""
        return sum(region.reopen_count for region in self._regions)

    @property
    def engine_end(self) -> Any:
        """The engine's reader, which a notifier watches: for responses (in a client) or requests (in a server).

        The engine is the code in C or Python that accesses the region.
        """
        return self._calls.incoming.engine_end


def close_after_fork(resource: Any) -> Any:
    """Register `resource`, an endpoint, file or map, to be closed in each forked child. Return `resource`.

    A child inherits the open file and with it the parent's claim on the topic, so the claim would outlive the parent.
    The child also closes endpoints that the parent is still opening.
    """
    _closed_after_fork.add(resource)
    return resource


def finish(ends: Iterable[Any]) -> None:
    """Complete the opening of all writers and readers of the engine concurrently.

    Raises the error of the first that cannot be opened.

    After an exception, also of a signal handler, close the endpoints that are not open yet, so that no claim remains.
    """
    waiting: dict[Any, int | None] = dict.fromkeys(ends)
    try:
        _step_until_open(waiting)
    except BaseException:
        for end in waiting:
            end.close()
        raise


def _step_until_open(waiting: dict[Any, int | None]) -> None:
    while waiting:
        moved = False
        for end, before in list(waiting.items()):
            step = end.step()
            moved = moved or step != before
            if step is None:
                del waiting[end]
            else:
                waiting[end] = step
        if not moved:
            time.sleep(_LOOK)


_closed_after_fork: weakref.WeakSet[Any] = weakref.WeakSet()


def _in_child() -> None:
    for resource in list(_closed_after_fork):
        with suppress(BufferError):  # a map that is in use: its region closes the map
            getattr(resource, "close_in_child", resource.close)()


os.register_at_fork(after_in_child=_in_child)
