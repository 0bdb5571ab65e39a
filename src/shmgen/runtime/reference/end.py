"""The base class of Writer and Reader: opens a region in steps that do not wait, and runs one call at a time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from threading import get_ident
from typing import Any, TypeVar

from shmgen.core import abi
from shmgen.runtime.errors import Closed, Reentered, RegionRetired, ShmError
from shmgen.runtime.reference.lock import Lock
from shmgen.runtime.reference.region import Region
from shmgen.runtime.refusals import Status, log_recreated, not_open_error, retired_error
from shmgen.runtime.region import header as h
from shmgen.runtime.region.record_locks import WRITER_LOCK, byte_is_locked
from shmgen.runtime.region.settings import Settings

T = TypeVar("T")
_BY = "by"
_POLL = abi.POLL_MS / 1000
"""Seconds between two checks whether another thread's call has ended, and until a removed region is reopened."""
_REGISTERED = 0.1
"""Seconds for which a thread that waits for a call to end keeps other threads from beginning a call."""
_CHECKED = abi.REMOVED_MS / 1000
"""Seconds between two checks whether the region was removed."""


class NotOpenYet(Exception):
    """A removed region is being reopened, and the next step has to wait."""


class End:
    """One endpoint of a region: a writer or a reader. The endpoint is open after step() has returned None."""

    region: Region
    lock: Lock
    borrowed = 0
    """The number of the borrowed sample, or 0. If this machine needs the lock, the lock is held until give_back()."""
    reopen_count = 0
    lost = False
    """True if the region was removed and is being reopened."""

    def __init__(self, of: Settings) -> None:
        self.of = of
        self.pid = os.getpid()
        self.closed_error: ShmError | None = not_open_error(of, Status.OPENING, self.pid)
        self._caller: dict[str, int] = {}
        self._waiting = (0, 0.0)
        self._steps: Iterator[int] = self._open()
        self._checked = self._lost_at = self._retry_at = 0.0

    def _open(self) -> Generator[int, None, None]:
        raise NotImplementedError

    def step(self) -> int | None:
        """Open the endpoint up to the next wait, and return the reason for the wait, a constant of opening.py.

        Do not wait: the caller calls this method again later. Return None when the endpoint is open.
        """
        try:
            return next(self._steps, None)
        except BaseException:
            self.close()
            raise

    def load(self, word: int) -> int:
        """Return the header field at offset 4 * `word` bytes, or 0 while the region is being reopened."""
        return self._inspect(lambda: self.region.words[word], 0)

    def is_claimed(self) -> bool:
        """Return True if another open file, usually of another process, has claimed the topic."""
        return self._inspect(lambda: byte_is_locked(self.region.file, WRITER_LOCK), False)

    def is_removed(self) -> bool:
        """Return True if the region's file was removed from /dev/shm.

        In this case store `retired` in the header, so that all endpoints with the region open, PLCs too, reopen it.
        """
        return self._inspect(self._is_removed, True)

    def check(self) -> None:
        """Check whether the region was removed, at most once in REMOVED_MS.

        If so, the next call on this endpoint reopens the region, or raises RegionRetired if reopening is off.
        """
        with suppress(RegionRetired):
            self._inspect(self._need_region, None)

    def _is_removed(self) -> bool:
        removed = os.fstat(self.region.file).st_nlink == 0
        if removed and not self.of.passive:
            self.region.words[h.RETIRED] = 1
        return removed

    def _check(self) -> None:
        now = time.monotonic()
        if now - self._checked >= _CHECKED:
            self._checked = now
            self._is_removed()

    def _need_region(self) -> None:
        """Raise RegionRetired if the region was removed or replaced. A passive endpoint does not check."""
        if self.of.passive:
            return
        self._check()
        if self.region.words[h.RETIRED]:
            raise retired_error(self.of)

    @property
    def file(self) -> int:
        """The file descriptor of the region."""
        return self.region.file

    @property
    def lock_misses(self) -> int:
        return self.lock.misses

    def close(self) -> None:
        """Close the region. If another thread is inside a call on this endpoint, first wait until this call returns."""
        closed = not_open_error(self.of, Status.CLOSED, self.pid)
        if self._caller.get(_BY) == get_ident():  # a signal handler has interrupted a call of this thread
            self._release(closed)
            return
        try:
            self._acquire()
            self._release(closed)
        finally:
            self._release_call()

    def __del__(self) -> None:
        with suppress(Exception):  # at interpreter shutdown much is already deleted
            self.close()

    def close_in_child(self) -> None:
        """Close the region in a forked child. Release neither the parent's lock nor the parent's claim."""
        self._caller = {}
        if hasattr(self, "region"):
            self.region.semaphore.held.clear()
        if not isinstance(self.closed_error, Closed) or hasattr(self, "region") or self.lost:
            self._release(not_open_error(self.of, Status.IN_FORKED_CHILD, self.pid))

    def _release(self, why: ShmError) -> None:
        self._steps, self.lost = iter(()), False
        if not hasattr(self, "region"):
            self.closed_error = why
            return
        if hasattr(self, "lock"):
            self.lock.release()
        self.closed_error = why
        self.region.close()
        del self.region

    def _inspect(self, inspect: Callable[[], T], while_reopening: T) -> T:
        """Return the result of `inspect`, even if this thread is inside another call on this endpoint.

        Return `while_reopening` if the region is being reopened.
        """
        if self._caller.get(_BY) == get_ident():
            if self.closed_error is not None:
                raise self.closed_error
            return inspect()
        try:
            return self._call_alone(inspect)
        except NotOpenYet:
            return while_reopening

    def _attempt(self, work: Callable[..., T], *arguments: Any) -> T:
        """Call `work` and return its result. If the region was removed, reopen the region and call `work` again.

        Raises NotOpenYet if the reopening has to wait.
        """
        if self.lost:
            self._reopen()
        if self.closed_error is not None:
            raise self.closed_error
        try:
            return work(*arguments)
        except RegionRetired:
            if not self.of.reopen:
                raise
        self._reopen()
        return work(*arguments)

    def _reopen(self) -> None:
        """Take the next steps of reopening a removed region. Raises NotOpenYet if the next step has to wait."""
        now = time.monotonic()
        if self.closed_error is None:
            self._lost_at = self._lost_at or now
            if self.borrowed or now < self._lost_at + _POLL:  # a writer may still complete its sample
                raise NotOpenYet
        if self.closed_error is None or 0 < self._retry_at < now:
            self._release(not_open_error(self.of, Status.OPENING, self.pid))
            self._steps, self.lost, self._retry_at = self._open(), True, 0.0
        if self._retry_at and self.closed_error is not None:
            raise self.closed_error
        try:
            if next(self._steps, None) is not None:
                raise NotOpenYet
        except ShmError as error:
            self._release(error)
            self.lost, self._retry_at = True, now + abi.RETRY_MS / 1000
            raise
        self.lost, self._lost_at = False, 0.0
        self.reopen_count += 1
        if self.reopen_count == 1:
            log_recreated(self.of, Status.REGION_RETIRED)

    def _call_alone(self, work: Callable[..., T], *arguments: Any) -> T:
        """Call `work`, and make the calls of other threads wait until `work` returns.

        Raises Reentered if this thread is already inside a call. A signal handler may raise at any time, even during
        _release_call(). Therefore _release_call() is called once more after an exception.
        """
        if self._caller.get(_BY) == get_ident():
            raise Reentered(
                f"{self.of.topic}: this {self.of.word} was called during another call: do not use it in a signal "
                "handler, property or finalizer, or install the extension in C"
            )
        try:
            try:
                self._acquire()
                return self._attempt(work, *arguments)
            finally:
                self._release_call()
        except BaseException as error:
            self._release_call()
            if self.closed_error is not None and isinstance(error, Exception) and not isinstance(error, NotOpenYet):
                raise self.closed_error from None  # the interrupting code has closed the endpoint
            raise

    def _acquire(self) -> None:
        """Begin a call as soon as no other thread is inside a call and no other thread has waited for longer.

        If nobody waited for longer, a thread that publishes in a tight loop would keep all other threads out.
        """
        me = get_ident()
        while not self._is_next(me) or self._caller.setdefault(_BY, me) != me:  # setdefault() is atomic between threads
            time.sleep(_POLL)
        self._waiting = (me, 0.0)

    def _is_next(self, me: int) -> bool:
        """Register the thread `me` as the next one to begin a call, and return True.

        If another thread is registered, return False. A registration expires after 0.1 s, because an exception may have
        interrupted the registered thread.
        """
        thread, until = self._waiting
        now = time.monotonic()
        if thread != me and now < until:
            return False
        self._waiting = (me, now + _REGISTERED)
        return True

    def _release_call(self) -> None:
        if self._caller.get(_BY) == get_ident():
            if hasattr(self, "lock") and not self.borrowed:
                self.lock.release()
            self._caller.clear()
