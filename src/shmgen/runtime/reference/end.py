"""What the two ends of a region share: opened in steps, closed once, and one call at a time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from threading import get_ident
from typing import Any, TypeVar

from shmgen.core import abi
from shmgen.runtime.errors import Closed, Reentered, ShmError
from shmgen.runtime.reference.lock import Lock
from shmgen.runtime.reference.region import Region
from shmgen.runtime.refusals import Status, gone, retired
from shmgen.runtime.region import header as h
from shmgen.runtime.region.looks import WRITER_LOCK, byte_is_locked
from shmgen.runtime.region.settings import Settings

T = TypeVar("T")
_BY = "by"
_POLL = abi.POLL_MS / 1000
"""Seconds between two looks whether another thread's call has ended."""


class End:
    """One end. Not open until step() returns None."""

    region: Region
    lock: Lock
    borrowed = 0
    """Number of the sample that is being read in place, with the lock where it is needed; 0 = none."""

    def __init__(self, of: Settings) -> None:
        self.of = of
        self.pid = os.getpid()
        self.gone: ShmError | None = gone(of, Status.OPENING, self.pid)
        self._taken: dict[str, int] = {}
        self._steps: Iterator[int] = self._open()

    def _open(self) -> Generator[int, None, None]:
        raise NotImplementedError

    def step(self) -> int | None:
        """Opens a little further, without waiting: None once it is open, a number for what is waited for."""
        try:
            return next(self._steps, None)
        except BaseException:
            self.close()
            raise

    def load(self, word: int) -> int:
        """A word of the header, by its place in steps of four bytes."""
        if self.gone is not None:
            raise self.gone
        return self.region.words[word]

    def is_claimed(self) -> bool:
        """Whether a process has claimed the topic."""
        self.load(0)
        return byte_is_locked(self.region.file, WRITER_LOCK)

    def is_removed(self) -> bool:
        """Whether the region's file is gone from /dev/shm. Those who have it open, PLCs too, are told then."""
        self.load(0)
        removed = os.fstat(self.region.file).st_nlink == 0
        if removed and not self.of.passive:
            self.region.words[h.RETIRED] = 1
        return removed

    def _need_region(self) -> None:
        """Raises RegionRetired if it was removed or replaced; a tool that watches looks for itself."""
        if self.load(h.RETIRED) and not self.of.passive:
            raise retired(self.of)

    @property
    def file(self) -> int:
        """The descriptor of the region."""
        return self.region.file

    @property
    def lock_misses(self) -> int:
        return self.lock.misses

    def close(self) -> None:
        """Lets go of the region, once another thread's call has ended."""
        closed = gone(self.of, Status.CLOSED, self.pid)
        if self._taken.get(_BY) == get_ident():  # by what came upon a call of this thread
            self._let_go(closed)
            return
        try:
            self._take()
            self._let_go(closed)
        finally:
            self._leave()

    def __del__(self) -> None:
        with suppress(Exception):  # at the end of a process much is gone already
            self.close()

    def disown(self) -> None:
        """In a forked child: lets go of the open file, and with it of the parent's claim, and of nothing else."""
        self._taken = {}
        if hasattr(self, "region"):
            self.region.semaphore.held.clear()
        if not isinstance(self.gone, Closed) or hasattr(self, "region"):
            self._let_go(gone(self.of, Status.IN_FORKED_CHILD, self.pid))

    def _let_go(self, why: ShmError) -> None:
        self._steps = iter(())
        if not hasattr(self, "region"):
            self.gone = why
            return
        if hasattr(self, "lock"):
            self.lock.release()
        self.gone = why
        self.region.close()
        del self.region

    def _one_call(self, work: Callable[..., T], *arguments: Any) -> T:
        """Other threads wait; what interrupts a call of this thread and calls again is told, before it does harm.

        A signal handler may raise between any two instructions here: who leaves twice has left for certain.
        """
        if self._taken.get(_BY) == get_ident():
            raise Reentered(
                f"{self.of.topic}: this {self.of.word} is called while a call of it runs: a signal handler, a "
                "property or a finalizer cannot use it then; the extension in C can"
            )
        try:
            try:
                self._take()
                if self.gone is not None:
                    raise self.gone
                return work(*arguments)
            finally:
                self._leave()
        except BaseException as error:
            self._leave()
            if self.gone is not None and isinstance(error, Exception):
                raise self.gone from None  # closed by what interrupted it
            raise

    def _take(self) -> None:
        while self._taken.setdefault(_BY, get_ident()) != get_ident():  # one step, whatever the threads do
            time.sleep(_POLL)

    def _leave(self) -> None:
        if self._taken.get(_BY) == get_ident():
            if hasattr(self, "lock") and not self.borrowed:
                self.lock.release()
            self._taken.clear()
