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
from shmgen.live.session import Session
from shmgen.runtime import can_wait_for_many

BEAT = 0.1
"""The heartbeat interval in seconds. The PLC's blocks consider a writer dead after 1 s without a heartbeat."""
_START_LIMIT = 5.0
"""The time in seconds after which the bridge no longer waits for ROS to connect one topic, service or action."""
_END_LIMIT = 1.0
"""The maximum time in seconds that a reload waits until one topic, service or action has stopped."""


@dataclass(slots=True)
class Sides:
    """The topics, services and actions that the bridge carries. One of them is called a side.

    `beaten` is the time of the last round of heartbeats.
    """

    log: Callable[[str], None]
    report_alive: Callable[[], None] = lambda: None
    """A callback after each round of heartbeats."""
    resolve: Callable[[str], str] = lambda name: name
    """Maps a name in shmgen.toml to the name in the ROS graph, for backends without their own remapping."""
    is_over: Callable[[], bool] = lambda: False
    """Returns True once the bridge has to stop. The methods of this class then wait no longer."""
    beaten: float = field(default_factory=time.monotonic)
    _stopping: threading.Event = field(default_factory=threading.Event)
    _listener: Listener | None = None
    _carried: dict[Any, Side] = field(default_factory=dict)
    """The sides by the key of their route. Assign a new dictionary for each change, because other threads read it."""
    _counters: dict[tuple[type, str], Counters] = field(default_factory=dict)
    """The counters of all names, also of removed topics. A topic that is added again continues its old counters."""

    def __post_init__(self) -> None:
        self._listener = Listener(self._stopping) if can_wait_for_many() else None
        threading.Thread(target=self._beat, name="beat", daemon=True).start()

    def __iter__(self) -> Iterator[Side]:
        return iter(list(self._carried.values()))

    def open(self, session: Session) -> None:
        """Create all topics, services and actions, and wait for the first attempt to open each region.

        The bridge repeats failed attempts in the background. Raises Rejected if shmgen.toml has errors.
        """
        self._create(plan.everything(session, self.resolve))

    def start(self, backend: Backend) -> None:
        """Connect all topics, services and actions to ROS.

        Raises ValueError if ROS lacks a message type, or if its definition of a type differs from shmgen's.
        """
        self._connect(self, backend)

    def change(self, session: Session, backend: Backend) -> None:
        """Switch to the configuration of `session`. Unchanged topics, services and actions continue.

        All counters stay. If ROS rejects a new topic, service or action, restore the previous configuration and raise
        the error. Raises Rejected if the new configuration has errors.
        """
        routes = {route.key: route for route in plan.everything(session, self.resolve)}
        before = dict(self._carried)
        ended = {_name(one.route): one for key, one in before.items() if key not in routes}
        added = [route for key, route in routes.items() if key not in before]
        new, changed = ([route for route in added if (_name(route) in ended) is known] for known in (False, True))
        replaced = [ended.pop(_name(route)) for route in changed]
        pairs = zip(replaced, changed, strict=True)
        ends = {route.key: one.end for one, route in pairs if _uses_same_region(one.route, route)}
        try:
            self._connect(self._create(new), backend)
            self._end(replaced, handed_over=list(ends.values()))
            self._connect(self._create(changed, ends), backend)
        except Exception:
            self._end([one for key, one in self._carried.items() if key not in before])
            lost = [one.route for one in replaced if one.route.key not in self._carried]
            self._connect(self._create(lost), backend)
            raise
        self._end(ended.values())
        for one in ended.values():
            self.log(f"{one.about.name}: removed from shmgen.toml, no longer carried: {one.counters}")
        self._carried = {key: self._carried[key] for key in routes}

    def check_qos(self) -> None:
        """Compare the QoS of each topic with the QoS of its peers, and report incompatible peers."""
        for side in self:
            with suppress(Exception):  # any exception of a ROS library: the next check retries
                side.counters.report_qos(side.qos_problem())

    def stop(self) -> None:
        """Stop all topics, services and actions while ROS is still connected."""
        self._stopping.set()
        for side in self:
            side.stopping.set()
        for side in self:
            side.stop()

    def close(self) -> None:
        """Stop all topics, services and actions, and close all regions."""
        self.stop()
        for side in self:
            side.end.close()

    def _create(
        self, routes: Iterable[Route | CallRoute], ends: Mapping[Any, Any] = MappingProxyType({})
    ) -> list[Side]:
        """Create the topic, service or action of each route, and wait until each has tried once to open its region.

        `ends` maps the key of a route to an already open region endpoint that the new topic takes over.
        """
        sides = [self._side(route, ends.get(route.key)) for route in routes]
        self._carried = {**self._carried, **{one.route.key: one for one in sides}}
        for one in sides:
            while not one.end.attempted.wait(POLL_INTERVAL) and not self.is_over():
                pass
        return sides

    def _side(self, route: Route | CallRoute, end: Any = None) -> Side:
        counters = self._counters.setdefault(_name(route), Counters(route.about.name, self.log))
        counters.complaint = counters.incompatible_peer = ""
        match route:
            case Route(to_plc=True):
                return ToPlc(route, counters, end)
            case Route():
                return FromPlc(route, counters, self._listener, end)
            case CallRoute() if route.entry.type.kind == "srv":
                return (PlcServiceServer if route.entry.on_plc else PlcServiceClient)(route, counters)
            case CallRoute():
                return (PlcActionServer if route.entry.on_plc else PlcActionClient)(route, counters)

    def _connect(self, sides: Iterable[Side], backend: Backend) -> None:
        """Connect `sides` (topics, services and actions) to ROS, one after another, in a thread.

        If ROS blocks the thread for 5 s, continue with the next one in a new thread. Raises the last error, if any.
        """
        waiting, failed = list(sides), list[Exception]()
        while waiting and not self.is_over():
            thread = threading.Thread(target=_start, args=(backend, waiting, failed), name="start", daemon=True)
            thread.start()
            left, since = len(waiting), time.monotonic()
            while thread.is_alive() and not self.is_over():
                thread.join(POLL_INTERVAL)
                if len(waiting) < left:
                    left, since = len(waiting), time.monotonic()
                elif waiting and time.monotonic() - since > _START_LIMIT:
                    name = waiting.pop(0).about.name
                    self.log(f"{name}: ROS did not connect this entry within {_START_LIMIT:g} s; the others continue")
                    break
        if failed:
            raise failed[-1]

    def _end(self, sides: Iterable[Side], handed_over: Collection[RegionEndpoint[Any]] = ()) -> None:
        """Stop `sides` (topics, services and actions) and close their regions.

        Keep the regions in `handed_over` open, so that no sample is lost. Wait at most 1 s for each of `sides`. If a
        ROS call blocks longer, a background thread completes the stop.
        """
        ending = list(sides)
        self._carried = {key: one for key, one in self._carried.items() if one not in ending}
        for one in ending:
            one.stopping.set()
        for one in ending:
            closes = one.end not in handed_over
            thread = threading.Thread(target=one.remove, args=(closes,), name="end", daemon=True)
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


def _start(backend: Backend, waiting: list[Side], failed: list[Exception]) -> None:
    """Connect each entry of `waiting` to ROS, and remove it, until a new thread takes over. Add errors to `failed`."""
    while waiting:
        one = waiting[0]
        one.undo = backend.undo = []
        try:
            one.start(backend)
        except Exception as error:
            failed.append(error)
        if not waiting or waiting[0] is not one:
            return
        del waiting[0]


def _uses_same_region(old: Route | CallRoute, new: Route | CallRoute) -> bool:
    """Return True if both routes are topics with the same region. `new` can then take over the open region of `old`."""
    return isinstance(old, Route) and isinstance(new, Route) and old.region_key == new.region_key


def _name(route: Route | CallRoute) -> tuple[type, str]:
    return type(route.entry if isinstance(route, CallRoute) else route), route.about.name
