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
from shmgen.bridge.backend import Backend, Node, Outlet
from shmgen.bridge.counters import Counters
from shmgen.bridge.diagnostics import Reporter, Side
from shmgen.bridge.from_plc import FromPlc
from shmgen.bridge.to_plc import ToPlc
from shmgen.config import Config
from shmgen.diagnostics import Rejected
from shmgen.runtime import region_name

TICK = 0.1
"""Seconds from one look at everything to the next; the PLC's blocks take a writer for dead after a second."""
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
    sides = [_side(route, stopping, tell) for route in plan.routes(config)]
    try:
        say(f"{config.bridge.node}: backend {backend_name} ({why}), {len(sides)} topics")
        for line in summary(sides):
            say(line)
        node = Node(config.bridge.node, config.bridge.domain, tell, stopping.is_set, arguments)
        backend: Backend | None = module.connect(node)
        if backend is not None:
            try:
                _wire(backend, sides)
                report = _reports(config, backend, sides, tell)
                say("running")
                _watch(backend, sides, report, stopping, tell)
            finally:
                stopping.set()
                _leave(backend)
    finally:
        stopping.set()
        for side in sides:
            side.close()
        for line in counted(sides):
            say(line)


def summary(sides: Iterable[Side]) -> list[str]:
    """A line for each topic: which way, its type, its region."""
    rows = [
        (
            side.route.topic.topic,
            "-> PLC" if side.route.to_plc else "<- PLC",
            side.route.wire.type.short,
            f"/dev/shm/{region_name(side.route.topic.topic)}",
        )
        for side in sides
    ]
    return _table(rows)


def counted(sides: Iterable[Side]) -> list[str]:
    """A line for each topic: what became of its messages."""
    return _table((side.route.topic.topic, str(side.counters)) for side in sides)


def _side(route: plan.Route, stopping: threading.Event, tell: Say) -> Side:
    counters = Counters(route.topic.topic, tell)
    return (ToPlc if route.to_plc else FromPlc)(route, counters, stopping)


def _wire(backend: Backend, sides: Iterable[Side]) -> None:
    """Publishers first, so that nothing that comes in has to wait for them."""
    for side in sides:
        if isinstance(side, FromPlc):
            outlet = backend.publisher(side.route.wire)
            _check(side, outlet.new)
            side.start(outlet, backend.now)
    for side in sides:
        if isinstance(side, ToPlc):
            side.start()
            _check(side, backend.subscribe(side.route.wire, side.take))


def _check(side: Side, new: Callable[[], object]) -> None:
    if why := plan.misfit(side.route.kind, new()):
        short = side.route.wire.type.short
        raise ValueError(
            f"{side.route.topic.topic}: {short} of this ROS is not the one that shmgen knows: {why}\n"
            '  hint: set source = "..." in shmgen.toml to the ROS that runs here, generate, rebuild both sides'
        )


def _reports(config: Config, backend: Backend, sides: list[Side], tell: Say) -> Callable[[], None]:
    """What publishes the diagnostics when it is time."""
    period = config.bridge.diagnostics
    if not period:
        return lambda: None
    try:
        outlet: Outlet = backend.publisher(plan.diagnostics(config))
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
