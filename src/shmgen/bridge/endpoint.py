"""What the sides of the bridge repeat: an end of a region that is opened anew, and a thread that never gives up."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from shmgen.bridge.counters import Counters
from shmgen.live.regions import View
from shmgen.runtime import ShmError

LOOK = 0.1
"""Seconds after which a thread that waits for the PLC looks whether the bridge is to stop."""


class Closable(Protocol):
    """A publisher, subscriber, client or server."""

    def close(self) -> None: ...


T = TypeVar("T", bound=Closable)


class ReopeningEndpoint(Generic[T]):
    """Our end of a region, or of the regions of a service, which follows it when it is removed and made anew.

    `now` is None while there is none.
    """

    def __init__(self, make: Callable[[], T], region: str) -> None:
        """`region` is the one to look at: who removes a service removes both. Raises what `make` raises."""
        self._make = make
        self._region = region
        self.now: T | None = None
        self._view: View
        self.renewed()

    def renewed(self) -> T:
        """The end of the region that is there now. Raises as above, and OSError."""
        if self.now is None or self._view.removed:
            self.close()
            made = self._make()
            try:
                self._view = View(self._region)
            except BaseException:
                made.close()
                raise
            self.now = made
        return self.now

    def close(self) -> None:
        if self.now is not None:
            held, self.now = self.now, None
            held.close()
            self._view.close()


class WorkerThread:
    """A thread that takes step after step until the bridge stops; one that a region fails is told, and tried again."""

    def __init__(self, step: Callable[[], None], counters: Counters, stopping: threading.Event) -> None:
        """A step looks at `stopping` each LOOK itself."""
        self._step, self._counters, self._stopping = step, counters, stopping
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def ended(self) -> bool:
        """Whether no step is under way, after some patience; `stopping` is set by then."""
        if self._thread.ident is not None:  # it was started
            self._thread.join(2 * LOOK)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._step()
            except (ShmError, OSError) as error:
                self._counters.complain(str(error))
                self._stopping.wait(LOOK)
