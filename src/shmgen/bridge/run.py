"""Turns shmgen.toml into a process that carries its topics between ROS and the regions until it is told to stop."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from types import FrameType

from shmgen.bridge import choice, plan
from shmgen.bridge.actions import PlcActionClient, PlcActionServer
from shmgen.bridge.backend import Backend, Node, RosPublisher
from shmgen.bridge.counters import Counters
from shmgen.bridge.diagnostics import Reporter
from shmgen.bridge.from_plc import FromPlc
from shmgen.bridge.listener import Listener
from shmgen.bridge.services import PlcServiceClient, PlcServiceServer
from shmgen.bridge.side import Side
from shmgen.bridge.to_plc import ToPlc
from shmgen.config import Config
from shmgen.core.diagnostics import Rejected
from shmgen.live.session import Session
from shmgen.runtime import can_wait_for_many

TICK = 0.1
"""Seconds from one look at everything to the next; the PLC's blocks take a writer for dead after a second."""
_STATUS = 2048
"""Bytes that the diagnostics of one topic, service or action have at most."""
_FAREWELL = 0.5
"""Seconds a ROS gets to leave its graph."""

Say = Callable[[str], None]


def run(config: Config, arguments: tuple[str, ...], say: Say, tell: Say) -> None:
    """Until SIGINT, SIGTERM, or ROS's own word. `say` takes results, `tell` what a watcher should know.

    Raises Rejected, BackendMissing, ValueError (a type that ROS has otherwise) and what a Publisher raises.
    """
    stopping = _signals()
    backend_name, why = choice.chosen(config.bridge.backend)
    module = choice.module(backend_name)
    session = Session(config)
    sides = _sides(session, stopping, tell)
    try:
        carried = f"topics: {len(config.topics)}, services: {len(config.services)}"
        carried += f", actions: {len(config.actions)}" if config.actions else ""
        say(f"{config.bridge.node}: backend {backend_name} ({why}), {carried}")
        for line in summary(sides):
            say(line)
        largest = max(plan.largest(session), len(sides) * _STATUS)
        node = Node(config.bridge.node, config.bridge.domain, tell, stopping.is_set, arguments, largest)
        backend: Backend | None = module.connect(node)
        if backend is not None:
            try:
                for side in sides:
                    side.join(backend)
                report = _reports(session, backend, sides, tell)
                say("running")
                _watch(backend, sides, report, stopping, tell)
            finally:
                stopping.set()
                for side in sides:
                    side.leave()
                _leave(backend)
    finally:
        stopping.set()
        for side in sides:
            side.close()
        for line in counted(sides):
            say(line)


def summary(sides: Iterable[Side]) -> list[str]:
    """A line for each: its name, which way, its type, its region."""
    return _table((side.about.name, side.about.way, side.about.type, side.about.region) for side in sides)


def counted(sides: Iterable[Side]) -> list[str]:
    """A line for each: what became of its messages."""
    return _table((side.about.name, str(side.counters)) for side in sides)


def _sides(session: Session, stopping: threading.Event, tell: Say) -> list[Side]:
    routes, services, actions = plan.routes(session), plan.services(session), plan.actions(session)
    listener = Listener(stopping) if can_wait_for_many() else None
    sides: list[Side] = []
    try:
        for route in routes:
            counters = Counters(route.topic.topic, tell)
            if route.to_plc:
                sides.append(ToPlc(route, counters, stopping))
            else:
                sides.append(FromPlc(route, counters, stopping, listener))
        for service in services:
            counters = Counters(service.service.name, tell)
            sides.append(
                (PlcServiceServer if service.service.on_plc else PlcServiceClient)(service, counters, stopping)
            )
        for action in actions:
            counters = Counters(action.action.name, tell)
            sides.append((PlcActionServer if action.action.on_plc else PlcActionClient)(action, counters, stopping))
    except BaseException:
        for side in sides:
            side.close()
        raise
    return sides


def _reports(session: Session, backend: Backend, sides: list[Side], tell: Say) -> Callable[[], None]:
    """What publishes the diagnostics when it is time."""
    config = session.config
    period = config.bridge.diagnostics
    if not period:
        return lambda: None
    try:
        outlet: RosPublisher = backend.publisher(plan.diagnostics(session))
    except (Rejected, ValueError) as error:
        tell(f"no diagnostics are published: {str(error).partition(chr(10))[0]}")
        return lambda: None
    reporter = Reporter(config.bridge.node)
    due = time.monotonic() + period

    def report() -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = max(due + period, time.monotonic())
            message = outlet.new()
            reporter.fill(message, sides, backend.now())
            outlet.send(message)

    return report


def _watch(
    backend: Backend, sides: list[Side], report: Callable[[], None], stopping: threading.Event, tell: Say
) -> None:
    """Until the end. SIGUSR1 shows the counters."""
    asked = threading.Event()
    signal.signal(signal.SIGUSR1, lambda number, frame: asked.set())
    while not stopping.wait(TICK):
        for side in sides:
            side.tick()
        with suppress(Exception):  # the next one will do
            report()
        if asked.is_set():
            asked.clear()
            for line in counted(sides):
                tell(line)
        if not backend.alive():
            tell("ROS has told this node to end")
            return


def _leave(backend: Backend) -> None:
    """A ROS that cannot leave in time is left."""
    thread = threading.Thread(target=backend.close, daemon=True)
    thread.start()
    thread.join(_FAREWELL)
    if thread.is_alive():  # nor may it hold up the end of the process
        last_resort = threading.Timer(_FAREWELL / 2, os._exit, [int(sys.exc_info()[0] is not None)])
        last_resort.daemon = True
        last_resort.start()


def _signals() -> threading.Event:
    stopping = threading.Event()

    def stop(number: int, frame: FrameType | None) -> None:
        stopping.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    return stopping


def _table(rows: Iterable[tuple[str, ...]]) -> list[str]:
    cells = list(rows)
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  " + "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in cells
    ]
