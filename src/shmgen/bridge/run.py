"""Runs the bridge process: start, diagnostics, reload of shmgen.toml, and stop."""

from __future__ import annotations

import atexit
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from itertools import count
from typing import Any

from shmgen.bridge import plan
from shmgen.bridge.backend import Backend, Node, RosPublisher, largest
from shmgen.bridge.common import choice, watchdog
from shmgen.bridge.common.arguments import Arguments, parse, with_parameters
from shmgen.bridge.common.counters import Counters
from shmgen.bridge.diagnostics import Reporter
from shmgen.bridge.endpoint import Side
from shmgen.bridge.sides import BEAT, Sides
from shmgen.config import Config
from shmgen.core.diagnostics import Rejected
from shmgen.core.flag import Flag
from shmgen.live.session import Session
from shmgen.runtime import Time

_STATUS_SIZE = 2048
"""The maximum size in bytes of the diagnostics of one topic, service or action."""
_SHUTDOWN_TIMEOUT = 0.5
"""The time limit in seconds for the ROS library to leave the graph."""
_MAX_HEARTBEAT_AGE = 1.0
"""The maximum age of the last heartbeat in seconds for a report to systemd's watchdog that the bridge is alive."""

_TURNS_TO_CHECK_QOS = 5
_SETTLE_INTERVAL = 0.2
"""The interval in seconds between two reads of shmgen.toml during a reload."""

Log = Callable[[str], None]


class NothingListed(ValueError):
    """shmgen.toml lists no topic, service or action."""


class _Signals:
    """Flags that signals set: `stop` by SIGINT and SIGTERM, `counters` by SIGUSR1, and `reload` by SIGHUP."""

    def __init__(self) -> None:
        self.stop, self.counters, self.reload = (Flag() for _ in range(3))
        signal.signal(signal.SIGUSR1, lambda number, frame: self.counters.set())
        signal.signal(signal.SIGHUP, lambda number, frame: self.reload.set())
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._end)
        watchdog.limit_signals((signal.SIGINT, signal.SIGTERM))

    def beat(self) -> None:
        """Restart the watchdog. Do nothing after a stop signal, because each shutdown step then sets its own limit."""
        if not self.stop.is_set():
            watchdog.reset()

    def _end(self, number: int, frame: object) -> None:
        self.stop.set()
        watchdog.reset(watchdog.STOP_LIMIT)
        watchdog.signals_handled()


def run(config: Config, arguments: tuple[str, ...], show: Log, log: Log, load: Callable[[], Config]) -> None:
    """Run the bridge until SIGINT, SIGTERM, or until ROS shuts down the node.

    `arguments` are the ROS arguments. `show` prints a line, `log` logs a line, and `load` reads shmgen.toml again.
    Raises Rejected if the configuration has errors, and BackendMissing if no backend is installed. Raises ValueError
    if ROS lacks a type, or if the definition in ROS differs from shmgen's.
    """
    signals = _Signals()
    backend_name, why = choice.chosen(config.bridge.backend)
    module = choice.module(backend_name)
    has_ros = backend_name in ("ros1", "ros2")
    ros_arguments = _arguments(config, backend_name, has_ros, arguments, log)

    def load_with_parameters() -> Config:
        return with_parameters(load(), ros_arguments.parameters)

    config = with_parameters(config, ros_arguments.parameters)
    session = Session(config)
    sinks = [log]

    def log_to_all(text: str) -> None:
        for sink in sinks:
            sink(text)

    resolve = (lambda name: name) if has_ros else ros_arguments.resolve
    sides = Sides(log_to_all, signals.beat, resolve, signals.stop.is_set)
    try:
        sides.open(session)
        show(f"{config.bridge.node}: backend {backend_name} ({why}), {_counts_text(config)}")
        for line in summary(sides):
            show(line)
        name, space = (config.bridge.node, "/") if has_ros else (ros_arguments.node, ros_arguments.namespace)
        node = Node(name, config.bridge.domain, log_to_all, signals.stop.is_set, arguments, _largest(session), space)
        backend: Backend | None = module.connect(node)
        if backend is not None:
            sinks.append(backend.publish_log)
            try:
                if ros_arguments.use_sim_time and not has_ros:
                    _use_simulated_time(backend, session, sides.resolve("/clock"), log)
                sides.start(backend)
                report = _reports(session, backend, sides, backend.name or name, log)
                show("running")
                _notify("READY=1")
                reload = partial(_reload, config, load_with_parameters, node, sides, backend, signals.stop)
                _watch(backend, sides, report, signals, log, reload)
            finally:
                signals.stop.set()
                _notify("STOPPING=1")
                _end_within_limit(sides.stop)
                _end_within_limit(lambda: _leave(backend))
    finally:
        signals.stop.set()
        _end_within_limit(sides.close)
        watchdog.cancel()
        for line in counter_lines(sides):
            show(line)


def _arguments(config: Config, backend: str, has_ros: bool, words: tuple[str, ...], log: Log) -> Arguments:
    """Return `words`, the ROS arguments, parsed. Raises ValueError if an argument is wrong.

    If `has_ros` is True, accept unknown arguments, because rospy or rclpy parses the arguments too. If `has_ros` is
    False, log the arguments that have no effect.
    """
    try:
        parsed = parse(words, config.bridge.node, is_strict=not has_ros)
    except ValueError as error:
        raise ValueError(f"{backend}: {error}") from None
    for word in () if has_ros else parsed.ignored:
        log(f"{backend}: {word} has no effect without ROS")
    return parsed


def _use_simulated_time(backend: Backend, session: Session, topic: str, log: Log) -> None:
    """Let backend.now() return the newest time that ROS has published on `topic`, or zero before the first message."""
    newest = Time()

    def take(message: Any) -> None:
        nonlocal newest
        newest = Time(message.clock.sec, message.clock.nanosec)

    backend.now = lambda: newest  # type: ignore[method-assign]
    wire = plan.own_topic(session, topic, "rosgraph_msgs/Clock", qos="best_effort")
    backend.subscribe(wire, take, Counters("/clock", log))


def _end_within_limit(step: Callable[[], None]) -> None:
    """Call `step`, a part of the shutdown. After 2 s, the watchdog ends the process with status 1."""
    watchdog.reset(watchdog.STOP_LIMIT)
    step()


def summary(sides: Iterable[Side]) -> list[str]:
    """Return a line for each topic, service and action: its name, direction, type and region."""
    return _table((side.about.name, side.about.direction, side.about.type, side.about.region) for side in sides)


def counter_lines(sides: Iterable[Side]) -> list[str]:
    """Return a line for each topic, service and action: its name and counters."""
    return _table((side.about.name, str(side.counters)) for side in sides)


def _counts_text(config: Config) -> str:
    actions = f", actions: {len(config.actions)}" if config.actions else ""
    return f"topics: {len(config.topics)}, services: {len(config.services)}{actions}"


def _largest(session: Session) -> int:
    """Return the largest size limit in bytes of all serialized messages. Raises Rejected if a type has errors."""
    config = session.config
    sample_size = max((layout.size for layout in session.layouts(config.types_used).values()), default=0)
    entry_count = len(config.topics) + len(config.services) + len(config.actions)
    return max(largest(sample_size), entry_count * _STATUS_SIZE)


def _reports(session: Session, backend: Backend, sides: Sides, name: str, log: Log) -> Callable[[], None]:
    """Return a function that publishes diagnostics when they are due, or that does nothing if diagnostics are off."""
    config = session.config
    period = config.bridge.diagnostics
    if not period:
        return lambda: None
    try:
        wire = plan.own_topic(session, sides.resolve("/diagnostics"), "diagnostic_msgs/DiagnosticArray")
        outlet: RosPublisher = backend.publisher(wire)
    except (Rejected, ValueError) as error:
        log(f"no diagnostics are published: {str(error).partition(chr(10))[0]}")
        return lambda: None
    reporter = Reporter(name)
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
    backend: Backend,
    sides: Sides,
    report: Callable[[], None],
    signals: _Signals,
    log: Log,
    reload: Callable[[], str],
) -> None:
    """Check QoS, call `report` and handle signals until the bridge stops or ROS shuts down the node.

    `report` publishes the diagnostics. `reload` reads shmgen.toml again and returns lines to log.
    """
    for turn in count():
        if signals.stop.wait(BEAT):
            return
        if turn % _TURNS_TO_CHECK_QOS == 0:
            sides.check_qos()
        with suppress(Exception):  # the next report retries
            report()
        if signals.counters.is_set():
            signals.counters.clear()
            for line in counter_lines(sides):
                log(line)
        if signals.reload.is_set():
            signals.reload.clear()
            _notify(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")
            try:
                log(reload())
            except Exception as error:  # any exception of a ROS library
                log(f"shmgen.toml was not reloaded: {error}")
            _notify("READY=1")
        if time.monotonic() - sides.beaten < _MAX_HEARTBEAT_AGE:
            _notify("WATCHDOG=1")
        if not backend.alive():
            log("ROS has shut down this node")
            return


def _reload(before: Config, load: Callable[[], Config], node: Node, sides: Sides, backend: Backend, stop: Flag) -> str:
    """Read shmgen.toml again and switch to the new configuration. Return the lines to log.

    Raises Rejected or ValueError as run() does, and NothingListed. After an error, the bridge continues with the
    previous configuration.
    """
    config = _load_settled(load, stop)
    require_entries(config)
    session = Session(config)
    if _largest(session) > node.largest:
        raise ValueError("its messages exceed the size limit from the start of the bridge; restart the bridge")
    sides.change(session, backend)
    again = "; restart the bridge to apply the changes under [bridge]" if config.bridge != before.bridge else ""
    return "\n".join([f"shmgen.toml was reloaded: {_counts_text(config)}{again}", *summary(sides)])


def _load_settled(load: Callable[[], Config], stop: Flag) -> Config:
    """Read shmgen.toml until two reads are equal, because editors and `cp` empty a file before they write to it."""
    before: Config | str | None = None
    while True:
        now: Config | str
        try:
            if (now := load()) == before or stop.is_set():
                return now
        except Exception as error:
            if (now := str(error)) == before or stop.is_set():
                raise
        before = now
        stop.wait(_SETTLE_INTERVAL)


def require_entries(config: Config) -> None:
    """Check the configuration. Raises NothingListed if `config` has no topic, service or action."""
    if not (config.topics or config.services or config.actions):
        raise NothingListed("no topic, service or action is listed")


def _notify(state: str) -> None:
    """Send `state` to systemd if systemd started the bridge with Type=notify. Source: sd_notify(3)."""
    if address := os.environ.get("NOTIFY_SOCKET"):
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as outlet:
            outlet.sendto(state.encode(), "\0" + address[1:] if address.startswith("@") else address)


def _leave(backend: Backend) -> None:
    """Close the backend, and wait for that at most 0.5 s. After an error, let Python's exit end the process at once."""
    if sys.exc_info()[0] is not None:
        atexit.register(watchdog.exit_at_once, 1)
    thread = threading.Thread(target=backend.close, daemon=True)
    thread.start()
    thread.join(_SHUTDOWN_TIMEOUT)


def _table(rows: Iterable[tuple[str, ...]]) -> list[str]:
    cells = list(rows)
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  " + "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in cells
    ]
