"""The process: it carries what shmgen.toml lists between ROS and the regions until it is told to stop."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress

from shmgen.bridge import choice, plan
from shmgen.bridge.backend import Backend, Node, RosPublisher
from shmgen.bridge.diagnostics import Reporter
from shmgen.bridge.sides import BEAT, Side, Sides
from shmgen.config import Config
from shmgen.core.diagnostics import Rejected
from shmgen.live.session import Session

_STATUS = 2048
"""Bytes that the diagnostics of one topic, service or action have at most."""
_FAREWELL = 0.5
"""Seconds a ROS gets to leave its graph."""
_STUCK = 1.0
"""Seconds without a beat after which systemd's watchdog is not told any more that the bridge lives."""

Say = Callable[[str], None]


class _Asked:
    """What signals ask for: to stop (SIGINT, SIGTERM), the counters (SIGUSR1), shmgen.toml read again (SIGHUP)."""

    def __init__(self) -> None:
        self.stop, self.counters, self.reload = (threading.Event() for _ in range(3))
        meant: dict[int, threading.Event] = {signal.SIGUSR1: self.counters, signal.SIGHUP: self.reload}
        for number in (signal.SIGINT, signal.SIGTERM, *meant):
            signal.signal(number, lambda number, frame: meant.get(number, self.stop).set())


def run(config: Config, arguments: tuple[str, ...], say: Say, tell: Say, load: Callable[[], Config]) -> None:
    """Until SIGINT, SIGTERM, or ROS's own word. `say` takes results, `tell` what a watcher should know.

    `load` reads shmgen.toml again. Raises Rejected, BackendMissing, ValueError (a type that ROS has otherwise).
    """
    asked = _Asked()
    backend_name, why = choice.chosen(config.bridge.backend)
    module = choice.module(backend_name)
    session = Session(config)
    sides = Sides(tell)
    try:
        sides.carry(session, asked.stop.is_set)
        say(f"{config.bridge.node}: backend {backend_name} ({why}), {_carried(config)}")
        for line in summary(sides):
            say(line)
        node = Node(config.bridge.node, config.bridge.domain, tell, asked.stop.is_set, arguments, _largest(session))
        backend: Backend | None = module.connect(node)
        if backend is not None:
            try:
                sides.join(backend)
                report = _reports(session, backend, sides, tell)
                say("running")
                _notify("READY=1")
                _watch(backend, sides, report, asked, tell, lambda: _reload(config, load(), node, sides, backend))
            finally:
                asked.stop.set()
                _notify("STOPPING=1")
                sides.leave()
                _leave(backend)
    finally:
        asked.stop.set()
        sides.close()
        for line in counted(sides):
            say(line)


def summary(sides: Iterable[Side]) -> list[str]:
    """A line for each: its name, which way, its type, its region."""
    return _table((side.about.name, side.about.way, side.about.type, side.about.region) for side in sides)


def counted(sides: Iterable[Side]) -> list[str]:
    """A line for each: what became of its messages."""
    return _table((side.about.name, str(side.counters)) for side in sides)


def _carried(config: Config) -> str:
    actions = f", actions: {len(config.actions)}" if config.actions else ""
    return f"topics: {len(config.topics)}, services: {len(config.services)}{actions}"


def _largest(session: Session) -> int:
    config = session.config
    return max(plan.largest(session), (len(config.topics) + len(config.services) + len(config.actions)) * _STATUS)


def _reports(session: Session, backend: Backend, sides: Sides, tell: Say) -> Callable[[], None]:
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
    backend: Backend, sides: Sides, report: Callable[[], None], asked: _Asked, tell: Say, reload: Callable[[], str]
) -> None:
    """Until the end."""
    while not asked.stop.wait(BEAT):
        with suppress(Exception):  # the next one will do
            report()
        if asked.counters.is_set():
            asked.counters.clear()
            for line in counted(sides):
                tell(line)
        if asked.reload.is_set():
            asked.reload.clear()
            _notify(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")
            try:
                tell(reload())
            except (Rejected, ValueError, OSError) as error:
                tell(f"shmgen.toml is not taken: {error}")
            _notify("READY=1")
        if time.monotonic() - sides.beaten < _STUCK:
            _notify("WATCHDOG=1")
        if not backend.alive():
            tell("ROS has told this node to end")
            return


def _reload(before: Config, config: Config, node: Node, sides: Sides, backend: Backend) -> str:
    """Ends that did not change go on. Gives what there is to tell; raises as run()."""
    session = Session(config)
    if _largest(session) > node.largest:
        raise ValueError("its messages are larger than those the bridge was started with; start the bridge again")
    sides.carry(session)
    sides.join(backend)
    again = "; [bridge] takes effect when the bridge is started again" if config.bridge != before.bridge else ""
    return "\n".join([f"shmgen.toml was read again: {_carried(config)}{again}", *summary(sides)])


def _notify(state: str) -> None:
    """Tells systemd, where it has started the bridge with Type=notify. Source: sd_notify(3)."""
    if address := os.environ.get("NOTIFY_SOCKET"):
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as outlet:
            outlet.sendto(state.encode(), "\0" + address[1:] if address.startswith("@") else address)


def _leave(backend: Backend) -> None:
    """A ROS that cannot leave in time is left."""
    thread = threading.Thread(target=backend.close, daemon=True)
    thread.start()
    thread.join(_FAREWELL)
    if thread.is_alive():  # nor may it hold up the end of the process
        last_resort = threading.Timer(_FAREWELL / 2, os._exit, [int(sys.exc_info()[0] is not None)])
        last_resort.daemon = True
        last_resort.start()


def _table(rows: Iterable[tuple[str, ...]]) -> list[str]:
    cells = list(rows)
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  " + "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in cells
    ]
