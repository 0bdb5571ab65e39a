"""What the two ends of a region share: opened in steps, closed once, and one call at a time."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Generator, Iterator
from typing import Any, TypeVar

from shmgen.runtime.errors import Closed, InForkedChild, Reentered, ShmError
from shmgen.runtime.reference.lock import Lock
from shmgen.runtime.reference.region import REPAIR_LOCK, Region
from shmgen.runtime.region.looks import WRITER_LOCK
from shmgen.runtime.region.settings import Settings

T = TypeVar("T")


class End:
    """One end. Not open until step() returns None."""

    region: Region
    lock: Lock

    def __init__(self, of: Settings) -> None:
        self.of = of
        self.pid = os.getpid()
        self.gone: ShmError | None = Closed(f"{of.topic}: this {of.word} is not open yet")
        self._alone = threading.RLock()
        self._inside = False
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
        return self.region.byte_is_locked(WRITER_LOCK)

    def is_removed(self) -> bool:
        """Whether the region's file is gone from /dev/shm."""
        self.load(0)
        return os.fstat(self.region.file).st_nlink == 0

    @property
    def lock_misses(self) -> int:
        return self.lock.misses

    def close(self) -> None:
        """Lets go of the region, once another thread's call has ended."""
        with self._alone:
            self._let_go(Closed(f"{self.of.topic}: this {self.of.word} is closed"))

    def disown(self) -> None:
        """In a forked child: lets go of the open file, and with it of the parent's claim, and of nothing else."""
        self._alone, self._inside = threading.RLock(), False
        if hasattr(self, "region"):
            self.region.semaphore.held.clear()
        if not isinstance(self.gone, Closed) or hasattr(self, "region"):
            self._let_go(
                InForkedChild(
                    f"{self.of.topic}: this {self.of.word} belongs to process {self.pid}, from which this one was "
                    "forked; open one here, or start processes by the method `spawn`"
                )
            )

    def _let_go(self, gone: ShmError) -> None:
        self._steps = iter(())
        if not hasattr(self, "region"):
            self.gone = gone
            return
        if hasattr(self, "lock"):
            self.lock.release()
        self.gone = gone
        self.region.close()
        del self.region

    def _one_call(self, work: Callable[..., T], *arguments: Any) -> T:
        """Other threads wait; what interrupts a call of this thread and calls again is told, before it does harm."""
        with self._alone:
            if self._inside:
                raise Reentered(
                    f"{self.of.topic}: this {self.of.word} is called while a call of it runs: a signal handler, a "
                    "property or a finalizer cannot use it then; the extension in C can"
                )
            if self.gone is not None:
                raise self.gone
            try:
                try:
                    self._inside = True
                    return work(*arguments)
                finally:
                    self._leave()
            except BaseException as error:
                self._leave()  # where the exception came upon the first
                if self.gone is None:
                    self.region.unlock_byte(REPAIR_LOCK)  # or upon the end of a recovery
                elif isinstance(error, Exception):
                    raise self.gone from None  # closed by what interrupted it
                raise

    def _leave(self) -> None:
        self.lock.release()
        self._inside = False
