"""Opens the publisher, subscriber, client or server of a region in the background, and runs threads that use it."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from shmgen.bridge.backend import Backend, NoAnswer
from shmgen.bridge.common.counters import Counters, describe
from shmgen.bridge.plan import CallRoute, Route
from shmgen.runtime import Closed, LayoutMismatch, PermissionDenied, RegionInUse, RegionUnusable
from shmgen.runtime.region.resource import Closable

POLL_INTERVAL = 0.1
"""The interval in seconds at which a thread that waits for the PLC checks whether the bridge has to stop."""
RETRY_INTERVAL = 0.5
"""The interval in seconds between two attempts to open an endpoint. The bridge retries until it stops."""
_LOST = (RegionInUse, RegionUnusable, LayoutMismatch, PermissionDenied, Closed)
"""Errors after which an endpoint is of no more use."""


T = TypeVar("T", bound=Closable)


class RegionEndpoint(Generic[T]):
    """Opens the bridge's publisher, subscriber, client or server in a background thread, and reopens it. Thread-safe.

    The runtime reopens a removed region. This class reopens a region that another writer or layout has taken over.
    * `current`: the open publisher, subscriber, client or server, or None. `unavailable_reason`: the reason for None.
    * `attempted`: an event that is set after the first attempt to open the region.
    """

    def __init__(self, create: Callable[[], T], counters: Counters) -> None:
        self.current: T | None = None
        self.unavailable_reason = "the region is not open yet"
        self.attempted = threading.Event()
        self._counted_missed = 0
        self._create, self._counters = create, counters
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._logged_reason = ""
        self._open_in_background()

    def require(self) -> T:
        """Return the open publisher, subscriber, client or server. Raises NoAnswer if none is open."""
        if (end := self.current) is None:
            raise NoAnswer(f"there is no region: {self.unavailable_reason}")
        return end

    def count_missed(self, total: int) -> int:
        """Return how many samples were missed since the last call. `total` counts since the subscriber was opened."""
        with self._lock:
            new, self._counted_missed = total - self._counted_missed, total
        return new

    def report(self, error: Exception) -> None:
        """Log an error of the publisher, subscriber, client or server. Reopen the region if `error` means its loss."""
        if not self.discard_after(error):
            self._counters.log_rate_limited(describe(error))

    def discard_after(self, error: Exception) -> bool:
        """Return True if `error` means that the region is lost, and reopen the region in the background."""
        if not isinstance(error, _LOST):
            return False
        if self._shut():
            self._set_unavailable(str(error))
            self._open_in_background()
        return True

    def close(self) -> None:
        """Close permanently. Calls that wait in other threads raise Closed."""
        self._closed.set()
        self._shut()

    def _shut(self) -> bool:
        with self._lock:
            end, self.current = self.current, None
        if end is not None:
            end.close()
        return end is not None

    def _open_in_background(self) -> None:
        threading.Thread(target=self._open_until_closed, daemon=True).start()

    def _open_until_closed(self) -> None:
        while not self._closed.is_set():
            try:
                self._open()
                return
            except Exception as error:
                self._set_unavailable(str(error))
            finally:
                self.attempted.set()
            self._closed.wait(RETRY_INTERVAL)

    def _open(self) -> None:
        end = self._create()
        with self._lock:
            self.current, self.unavailable_reason, self._counted_missed = end, "", 0
        if self._closed.is_set():
            self._shut()
        elif self._logged_reason:
            self._logged_reason = ""
            self._counters.log("the region is open again")

    def _set_unavailable(self, reason: str) -> None:
        """Store the reason why the publisher, subscriber, client or server is not open. Log each new reason once."""
        self.unavailable_reason = self._counters.complaint = reason
        if reason != self._logged_reason and not self._closed.is_set():
            self._logged_reason = reason
            self._counters.log(reason)


class Side(ABC):
    """A topic, a service or an action that the bridge carries. If one fails, the others continue."""

    route: Any
    end: RegionEndpoint[Any]

    def __init__(self, route: Route | CallRoute, counters: Counters) -> None:
        self.route, self.about = route, route.about
        self.counters = counters
        self.stopping = threading.Event()
        self.undo: list[Callable[[], object]] = []
        """Functions that remove all that start() has created in ROS."""
        self.qos_problem: Callable[[], str] = lambda: ""
        """Returns the reason why a ROS peer has incompatible QoS, or `""`. start() sets it for topics."""

    @abstractmethod
    def start(self, backend: Backend) -> None:
        """Connect to ROS and start. Raises ValueError if ROS lacks the type, or defines it otherwise than shmgen."""

    def beat(self) -> None:  # noqa: B027 most sides have none to send
        """Send a heartbeat to the PLC, without blocking. Called ten times a second. By default, send nothing."""

    def silence(self) -> str:
        """Return the reason why the sender of a topic seems to be dead, or `""` if the sender is alive."""
        return ""

    def stop(self) -> bool:
        """Stop sending, while ROS is connected and `stopping` is set. Return False if a ROS call is still running."""
        return True

    def remove(self, closes: bool) -> None:
        """Stop the topic, service or action and remove it from ROS. If `closes` is True, also close its regions."""
        while not self.stop():
            time.sleep(POLL_INTERVAL)
        for undo in reversed(self.undo):
            undo()
        if closes:
            self.end.close()


class WorkerSide(Side):
    """A service or an action with a thread that calls `_step` until `stopping` is set."""

    def __init__(self, route: CallRoute, counters: Counters) -> None:
        super().__init__(route, counters)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def stop(self) -> bool:
        """Wait at most 0.2 s for the thread. Return True if the thread has ended. The caller first sets `stopping`."""
        if self._thread.ident is not None:  # the thread was started
            self._thread.join(2 * POLL_INTERVAL)
        return not self._thread.is_alive()

    @abstractmethod
    def _step(self, plc: Any) -> float:
        """Carry calls or goals. Return the delay in seconds until the next step.

        `plc` is the open region endpoint, or None while the region is not open. A long step should check `stopping`
        every 0.1 s.
        """

    def _run(self) -> None:
        while not self.stopping.is_set():
            pause = POLL_INTERVAL
            try:
                pause = self._step(self.end.current)
            except Exception as error:  # from a region or a ROS library
                self.end.report(error)
            self.stopping.wait(pause)
