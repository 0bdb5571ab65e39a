"""Owns all topics, services and actions of a bridge. Each fails on its own. One thread sends all heartbeats."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from shmgen.bridge import plan
from shmgen.bridge.actions import PlcActionClient, PlcActionServer
from shmgen.bridge.backend import Backend
from shmgen.bridge.common.counters import Counters, describe
from shmgen.bridge.endpoint import POLL_INTERVAL, RegionEndpoint, Side
from shmgen.bridge.listener import Listener
from shmgen.bridge.plan import CallRoute, Route
from shmgen.bridge.services import PlcServiceClient, PlcServiceServer
from shmgen.bridge.topics import FromPlc, ToPlc
from shmgen.core.model import Service
from shmgen.live.session import Session
from shmgen.runtime import can_wait_for_many

BEAT = 0.1
"""The heartbeat interval in seconds. The PLC's blocks consider a writer dead after 1 s without a heartbeat."""
_START_LIMIT = 5.0
"""The maximum time in seconds that ROS may take to connect one side before the bridge connects the next side."""
_END_LIMIT = 1.0
"""The maximum time in seconds that a reload waits until one side has stopped."""


@dataclass(slots=True, eq=False)
class _Carried:
    """A side with its route, and the functions that remove it from ROS, or None until it is connected to ROS."""

    route: Route | CallRoute
    side: Side
    stopping: threading.Event
    undo: list[Callable[[], object]] | None = None

    @property
    def name(self) -> tuple[type, str]:
        return _name(self.route)

    def end(self, closes: bool = True) -> None:
        """Stop the topic, service or action and remove it from ROS. Close its regions, except if `closes` is False."""
        while not self.side.stop():
            time.sleep(POLL_INTERVAL)
        for undo in reversed(self.undo or []):
            undo()
        if closes:
            self.side.end.close()


@dataclass(slots=True)
class Sides:
    """The topics, services and actions of shmgen.toml. `beaten` is the time of the last round of heartbeats."""

    log: Callable[[str], None]
    report_alive: Callable[[], None] = lambda: None
    """A callback after each round of heartbeats."""
    resolve: Callable[[str], str] = lambda name: name
    """Maps a name in shmgen.toml to the name in the ROS graph, for backends without their own remapping."""
    beaten: float = field(default_factory=time.monotonic)
    _stopping: threading.Event = field(default_factory=threading.Event)
    _listener: Listener | None = None
    _carried: dict[Any, _Carried] = field(default_factory=dict)
    """The sides by the key of their route. Replace the dictionary, never change it, because other threads read it."""
    _counters: dict[tuple[type, str], Counters] = field(default_factory=dict)
    """The counters of all names, also of removed ones. A topic that is added again continues its old counters."""

    def __post_init__(self) -> None:
        self._listener = Listener(self._stopping) if can_wait_for_many() else None
        threading.Thread(target=self._beat, name="beat", daemon=True).start()

    def __iter__(self) -> Iterator[Side]:
        return iter([one.side for one in self._carried.values()])

    def open(self, session: Session, is_over: Callable[[], bool] = lambda: False) -> None:
        """Try once to open each region; the bridge retries in the background. Raises Rejected.

        If `is_over` returns True, return at once.
        """
        self._create(self._routes(session), is_over)

    def start(self, backend: Backend, is_over: Callable[[], bool] = lambda: False) -> None:
        """Connect everything to ROS. Raises ValueError if ROS lacks a type or has another definition of it."""
        self._connect(list(self._carried.values()), backend, is_over)

    def change(self, session: Session, backend: Backend, is_over: Callable[[], bool] = lambda: False) -> None:
        """Switch to a new configuration. Unchanged sides continue, and all counters stay. Raises Rejected.

        If ROS rejects a side, restore the previous configuration and raise the error.
        """
        routes = {route.key: route for route in self._routes(session)}
        before = dict(self._carried)
        ended = {one.name: one for key, one in before.items() if key not in routes}
        added = [route for key, route in routes.items() if key not in before]
        new, changed = ([route for route in added if (_name(route) in ended) is known] for known in (False, True))
        replaced = [ended.pop(_name(route)) for route in changed]
        pairs = zip(replaced, changed, strict=True)
        ends = {route.key: one.side.end for one, route in pairs if _uses_same_region(one.route, route)}
        try:
            self._connect(self._create(new, is_over), backend, is_over)
            self._end(replaced, handed_over=list(ends.values()))
            self._connect(self._create(changed, is_over, ends), backend, is_over)
        except Exception:
            self._end([one for key, one in self._carried.items() if key not in before])
            lost = [one.route for one in replaced if one.route.key not in self._carried]
            self._connect(self._create(lost, is_over), backend, is_over)
            raise
        self._end(ended.values())
        for one in ended.values():
            self.log(f"{one.side.about.name}: removed from shmgen.toml, no longer carried: {one.side.counters}")
        self._carried = {key: self._carried[key] for key in routes}

    def check_qos(self) -> None:
        """Compare the QoS of each topic with the QoS of its peers, and report incompatible peers."""
        for side in self:
            if isinstance(side, FromPlc | ToPlc):
                with suppress(Exception):  # any exception of a ROS library: the next check retries
                    side.check_qos()

    def stop(self) -> None:
        """Stop all topics, services and actions while ROS is still connected."""
        self._stopping.set()
        for one in self._carried.values():
            one.stopping.set()
        for side in self:
            side.stop()

    def close(self) -> None:
        """Stop all topics, services and actions, and close all regions."""
        self.stop()
        for side in self:
            side.end.close()

    def _routes(self, session: Session) -> list[Route | CallRoute]:
        return [plan.renamed(route, self.resolve) for route in plan.everything(session)]

    def _create(
        self,
        routes: Iterable[Route | CallRoute],
        is_over: Callable[[], bool],
        ends: Mapping[Any, Any] = MappingProxyType({}),
    ) -> list[_Carried]:
        """Create a side for each route, and wait until each has tried to open its region, or `is_over` returns True.

        `ends` maps the key of a route to an open endpoint that the new side takes over.
        """
        sides = [self._side(route, ends.get(route.key)) for route in routes]
        self._carried = {**self._carried, **{one.route.key: one for one in sides}}
        for one in sides:
            while not one.side.end.attempted.wait(POLL_INTERVAL) and not is_over():
                pass
        return sides

    def _side(self, route: Route | CallRoute, end: Any = None) -> _Carried:
        stopping = threading.Event()
        counters = self._counters.setdefault(_name(route), Counters(route.about.name, self.log))
        counters.complaint = counters.incompatible_peer = ""
        side: Side
        match route:
            case Route(to_plc=True):
                side = ToPlc(route, counters, stopping, end)
            case Route():
                side = FromPlc(route, counters, stopping, self._listener, end)
            case CallRoute(entry=Service()):
                side = (PlcServiceServer if route.entry.on_plc else PlcServiceClient)(route, counters, stopping)
            case CallRoute():
                side = (PlcActionServer if route.entry.on_plc else PlcActionClient)(route, counters, stopping)
        return _Carried(route, side, stopping)

    def _connect(self, sides: list[_Carried], backend: Backend, is_over: Callable[[], bool]) -> None:
        """Connect sides to ROS in a thread, or in a new one if ROS blocks it. Raises the last error if one failed."""
        waiting, failed = list(sides), list[Exception]()
        while waiting and not is_over():
            thread = threading.Thread(target=_start, args=(backend, waiting, failed), name="start", daemon=True)
            thread.start()
            left, since = len(waiting), time.monotonic()
            while thread.is_alive() and not is_over():
                thread.join(POLL_INTERVAL)
                if len(waiting) < left:
                    left, since = len(waiting), time.monotonic()
                elif waiting and time.monotonic() - since > _START_LIMIT:
                    name = waiting.pop(0).side.about.name
                    self.log(f"{name}: ROS has not connected it within {_START_LIMIT:g} s; the others continue")
                    break
        if failed:
            raise failed[-1]

    def _end(self, sides: Iterable[_Carried], handed_over: Collection[RegionEndpoint[Any]] = ()) -> None:
        """Stop sides and close their regions, except `handed_over`, so that no sample is lost.

        A side that a ROS call blocks for more than 1 s ends later, in its own thread.
        """
        ending = list(sides)
        self._carried = {key: one for key, one in self._carried.items() if one not in ending}
        for one in ending:
            one.stopping.set()
        for one in ending:
            closes = one.side.end not in handed_over
            thread = threading.Thread(target=one.end, args=(closes,), name="end", daemon=True)
            thread.start()
            thread.join(_END_LIMIT)

    def _beat(self) -> None:
        """Send the heartbeats of all topics, services and actions until the bridge stops. Open no region."""
        while not self._stopping.wait(BEAT):
            for side in self:
                try:
                    side.beat()
                except Exception as error:  # one failed side must not stop the heartbeats of the others
                    side.counters.log_rate_limited(describe(error))
            self.beaten = time.monotonic()
            self.report_alive()


def _start(backend: Backend, waiting: list[_Carried], failed: list[Exception]) -> None:
    """Connect the sides in `waiting` until a new thread replaces this one. Add errors to `failed`."""
    while waiting:
        one = waiting[0]
        one.undo = backend.undo = []
        try:
            one.side.start(backend)
        except Exception as error:
            failed.append(error)
        if not waiting or waiting[0] is not one:
            return
        del waiting[0]


def _uses_same_region(old: Route | CallRoute, new: Route | CallRoute) -> bool:
    """Return True if both routes are topics with the same region, so that `new` can take over the region from `old`."""
    return isinstance(old, Route) and isinstance(new, Route) and old.region_key == new.region_key


def _name(route: Route | CallRoute) -> tuple[type, str]:
    return type(route.entry if isinstance(route, CallRoute) else route), route.about.name
