"""Wakes asyncio coroutines when a subscriber has a new sample. Each event loop has one notifier for all subscribers."""

from __future__ import annotations

import asyncio
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

from shmgen.core import abi
from shmgen.runtime import engine
from shmgen.runtime.region.resource import close_after_fork

T = TypeVar("T")
_POLL = abi.POLL_MS / 1000
"""Seconds until the next try if a sample exists but the lock is not free."""
_LONGEST_WAIT = 1e6
"""Seconds of the longest timer, because asyncio's timers have a limit."""


async def poll_until_found(poll: Callable[[], T | None], subscriber: Any, timeout: float, interval: float) -> T | None:
    """Return the first result of `poll` that is not None, or None after `timeout` seconds.

    Call `poll` when the subscriber has a new sample, and every `interval` seconds.
    """
    deadline = time.monotonic() + timeout
    while (result := poll()) is None and (left := deadline - time.monotonic()) > 0:
        if subscriber.unread:
            await asyncio.sleep(min(left, _POLL))
        else:
            await _waits_of(asyncio.get_running_loop()).wait(subscriber, min(left, interval, _LONGEST_WAIT))
    return result


class _LoopWaits:
    """All waits of one event loop: wakes each coroutine when the reader that this coroutine waits for has a sample."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._notifier: Any = close_after_fork(engine.Notifier())
        self._waiting: dict[Any, set[asyncio.Future[None]]] = {}
        weakref.finalize(self, self._notifier.close)  # closes the notifier when its event loop is garbage-collected
        loop.add_reader(self._notifier.fileno(), self._wake_ready)

    async def wait(self, subscriber: Any, timeout: float) -> None:
        """Return when the subscriber has a new sample or is closed, or after `timeout` seconds."""
        loop, reader = asyncio.get_running_loop(), subscriber.engine_end
        if reader not in self._waiting:
            subscriber.ready(0.0)  # raises PermissionDenied if this user may not open the event semaphore
            self._waiting[reader] = set()
            subscriber._on_close(weakref.finalize(subscriber, _forget_soon, weakref.ref(loop), reader))
        if not self._notifier.add(reader):
            await asyncio.sleep(min(timeout, _POLL))
            return
        future: asyncio.Future[None] = loop.create_future()
        self._waiting[reader].add(future)
        timer = loop.call_later(timeout, _finish, future)
        try:
            await future
        finally:
            timer.cancel()
            self._waiting.get(reader, set()).discard(future)

    def forget(self, loop: asyncio.AbstractEventLoop, reader: Any) -> None:
        """Wake the coroutines that wait for a closed reader. If no other reader is left, stop the notifier's thread."""
        for future in self._waiting.pop(reader, ()):
            _finish(future)
        self._notifier.remove(reader)
        if not self._waiting:
            loop.remove_reader(self._notifier.fileno())
            self._notifier.close()
            _of_loops.pop(loop, None)

    def _wake_ready(self) -> None:
        for reader in self._notifier.ready():
            for future in self._waiting.get(reader, ()):
                _finish(future)


_of_loops: weakref.WeakKeyDictionary[asyncio.AbstractEventLoop, _LoopWaits] = weakref.WeakKeyDictionary()


def _waits_of(loop: asyncio.AbstractEventLoop) -> _LoopWaits:
    if loop not in _of_loops:
        _of_loops[loop] = _LoopWaits(loop)
    return _of_loops[loop]


def _forget_soon(loop_of: Callable[[], asyncio.AbstractEventLoop | None], reader: Any) -> None:
    """Make the event loop stop watching a closed reader, in the thread of the event loop.

    Any thread may call this function. `loop_of` returns the event loop, or None if the loop no longer exists.
    """
    if (loop := loop_of()) is not None:
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(_forget, loop, reader)


def _forget(loop: asyncio.AbstractEventLoop, reader: Any) -> None:
    if loop in _of_loops:
        _of_loops[loop].forget(loop, reader)


def _finish(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
