"""An end of a region that is opened by a thread of its own, lost and opened anew; and a thread that works with one."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, Protocol, TypeVar

from shmgen.bridge.backend import NoAnswer
from shmgen.bridge.counters import Counters
from shmgen.live.regions import removed
from shmgen.runtime import Closed, RegionInUse, RegionRetired, ShmError

LOOK = 0.1
"""Seconds after which a thread that waits for the PLC looks whether the bridge is to stop."""
AGAIN = 0.5
"""Seconds from one failure to open an end to the next try, for as long as the bridge runs."""


class Closable(Protocol):
    """A publisher, subscriber, client or server."""

    def close(self) -> None: ...


T = TypeVar("T", bound=Closable)


class ReopeningEndpoint(Generic[T]):
    """Our end of a region, or of the regions of a service or action.

        sought ── opened, by a thread that nobody waits for ──▶ open ── lose() ──▶ sought

    `now` is None while it is sought, `why` says why. Who uses it holds `lock`.
    """

    def __init__(self, make: Callable[[], T], counters: Counters, stopping: threading.Event) -> None:
        self.now: T | None = None
        self.why = "the region is not open yet"
        self.lock = threading.Lock()
        self.tried = threading.Event()
        self.silence: Callable[[], str] = lambda: ""
        """Why the peer is taken for gone, or nothing."""
        self._make, self._counters, self._stopping = make, counters, stopping
        self._told = ""
        self._seek()

    @property
    def lock_misses(self) -> int:
        """How often a region's lock was not free in time."""
        return getattr(self.now, "lock_misses", 0)

    def look(self, rest: Callable[[T], object] = id) -> T | None:
        """`now`, or None if it was removed, after `rest` has taken what is left there. Is asked each LOOK."""
        if self.now is not None and removed(self.now):
            try:
                with suppress(RegionRetired):
                    rest(self.now)
            finally:
                self.lose("the region was removed")
        return self.now

    def beat(self, sign: Callable[[T], object] = id) -> None:
        """Looks, and gives a sign of life. Waits for nobody: who has it in hand does both himself."""
        if self.lock.acquire(blocking=False):
            try:
                if (now := self.look()) is not None:
                    sign(now)
            except Exception as error:
                self.meet(error)
            finally:
                self.lock.release()

    def meet(self, error: Exception) -> str:
        """Tells what its use has raised, and gives that text. One that another writer has taken is sought again."""
        expected = isinstance(error, (ShmError, OSError, NoAnswer))
        text = str(error) if expected else f"{type(error).__name__}: {error}"
        if isinstance(error, (RegionInUse, Closed)):
            self.lose(text)
        else:
            self._counters.complain(text)
        return text

    def lose(self, why: str) -> None:
        """It is of no more use."""
        if self.now is not None:
            self._fail(why)
            try:
                self._shut()
            finally:
                self._seek()

    def close(self) -> None:
        """For good, and `stopping` is set; one that is in use for longer is left to its user."""
        if self.lock.acquire(timeout=2 * LOOK):
            self._shut()
            self.lock.release()

    def _shut(self) -> None:
        held, self.now = self.now, None
        if held is not None:
            held.close()

    def _seek(self) -> None:
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._open()
                return
            except Exception as error:
                self._fail(str(error))
            finally:
                self.tried.set()
            self._stopping.wait(AGAIN)

    def _open(self) -> None:
        made = self._make()
        with self.lock:
            if self._stopping.is_set():
                made.close()
                return
            self.now, self.why = made, ""
            told, self._told = self._told, ""
        if told:
            self._counters.tell(f"{self._counters.topic}: the region is open again")

    def _fail(self, why: str) -> None:
        """Each reason is told once."""
        self.why = self._counters.complaint = why
        if why != self._told and not self._stopping.is_set():
            self._told = why
            self._counters.tell(f"{self._counters.topic}: {why}")


class WorkerThread(Generic[T]):
    """A thread that takes step after step with an end, or with none while it is sought, until the bridge stops."""

    def __init__(self, step: Callable[[T | None], float], end: ReopeningEndpoint[T], stopping: threading.Event) -> None:
        """A step looks at `stopping` each LOOK itself, and gives the seconds until the next."""
        self._step, self._end, self._stopping = step, end, stopping
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def leave(self) -> None:
        """Gives the step that is under way some time to end; `stopping` is set by then."""
        if self._thread.ident is not None:  # it was started
            self._thread.join(2 * LOOK)

    def _run(self) -> None:
        while not self._stopping.is_set():
            pause = LOOK
            with self._end.lock:
                try:
                    pause = self._step(self._end.look())
                except Exception as error:  # a region's, or whatever a ROS may raise
                    self._end.meet(error)
            self._stopping.wait(pause)
