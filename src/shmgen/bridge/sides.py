"""All that the bridge carries: opened, heard, changed and ended each for itself, and one thread that beats for all."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

from shmgen.bridge import plan
from shmgen.bridge.actions import PlcActionClient, PlcActionServer
from shmgen.bridge.backend import Backend
from shmgen.bridge.counters import Counters
from shmgen.bridge.endpoint import LOOK, ReopeningEndpoint
from shmgen.bridge.listener import Listener
from shmgen.bridge.plan import About, ActionRoute, Route, ServiceRoute
from shmgen.bridge.services import PlcServiceClient, PlcServiceServer
from shmgen.bridge.topics import FromPlc, ToPlc
from shmgen.live.session import Session
from shmgen.runtime import can_wait_for_many

BEAT = 0.1
"""Seconds from one sign of life to the next; the PLC's blocks take a writer for dead after a second."""


class Side(Protocol):
    """A topic, a service or an action. What becomes of it is no other's affair."""

    about: About
    counters: Counters
    end: ReopeningEndpoint[Any]

    @property
    def beat(self) -> Callable[[], None]:
        """Is called ten times a second, and waits for nobody."""

    @property
    def leave(self) -> Callable[[], None]:
        """Ends what is under way while its peers can still be told; `stopping` is set by then, and for what follows."""

    @property
    def close(self) -> Callable[[], None]:
        """Lets go of the regions."""

    def join(self, backend: Backend) -> None:
        """Begins to carry. Raises ValueError for a type that this ROS has otherwise or not at all."""


@dataclass(slots=True)
class _Carried:
    """`undo` takes back what it has made in the graph; None: it has not joined one."""

    side: Side
    stopping: threading.Event
    undo: list[Callable[[], None]] | None = None


@dataclass(slots=True)
class Sides:
    """Those of a configuration, in its order; each tells what it meets. `beaten` is when all had their last beat."""

    tell: Callable[[str], None]
    beaten: float = field(default_factory=time.monotonic)
    _stopping: threading.Event = field(default_factory=threading.Event)
    _listener: Listener | None = None
    _carried: dict[Any, _Carried] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._listener = Listener(self._stopping) if can_wait_for_many() else None
        threading.Thread(target=self._beat, name="beat", daemon=True).start()

    def __iter__(self) -> Iterator[Side]:
        return iter([one.side for one in self._carried.values()])

    def carry(self, session: Session, is_over: Callable[[], bool] = lambda: False) -> None:
        """From now on what it lists: what is as before goes on. Returns as soon as each was tried. Raises Rejected."""
        routes = {route.key: route for route in plan.everything(session)}
        self._end([one for key, one in self._carried.items() if key not in routes])
        self._carried = {key: self._carried.get(key) or self._made(route) for key, route in routes.items()}
        for side in self:
            while not side.end.tried.wait(LOOK) and not is_over():
                pass

    def join(self, backend: Backend) -> None:
        """Those that have not yet. Raises as Side.join() does of the last that cannot, which is not carried then."""
        failed: Exception | None = None
        for key, one in list(self._carried.items()):
            if one.undo is None:
                one.undo = backend.undo = []
                try:
                    one.side.join(backend)
                except Exception as error:
                    failed = error
                    self._end([self._carried.pop(key)])
        backend.undo = []
        if failed:
            raise failed

    def leave(self) -> None:
        """Ends what is under way while the graph is there."""
        for one in self._carried.values():
            one.stopping.set()
        self._stopping.set()
        for side in self:
            side.leave()

    def close(self) -> None:
        """Lets go of all regions."""
        self.leave()
        for side in self:
            side.close()

    def _end(self, carried: Iterable[_Carried]) -> None:
        for one in carried:
            one.stopping.set()
            one.side.leave()
            for undo in reversed(one.undo or []):
                undo()
            one.side.close()

    def _made(self, route: Route | ServiceRoute | ActionRoute) -> _Carried:
        stopping, counters = threading.Event(), Counters(route.about.name, self.tell)
        side: Side
        match route:
            case Route(to_plc=True):
                side = ToPlc(route, counters, stopping)
            case Route():
                side = FromPlc(route, counters, stopping, self._listener)
            case ServiceRoute():
                side = (PlcServiceServer if route.service.on_plc else PlcServiceClient)(route, counters, stopping)
            case ActionRoute():
                side = (PlcActionServer if route.action.on_plc else PlcActionClient)(route, counters, stopping)
        return _Carried(side, stopping)

    def _beat(self) -> None:
        """Never opens, and never waits but for its turn."""
        while not self._stopping.wait(BEAT):
            for side in self:
                side.beat()
            self.beaten = time.monotonic()
