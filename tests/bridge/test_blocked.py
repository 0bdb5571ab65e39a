"""Test that a blocking library call, with or without the GIL, ends the bridge or one topic instead of a silent stop."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from shmgen.bridge.common import watchdog
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import publisher
from shmgen.live.session import Session
from shmgen.runtime.region import header as h

from ..conftest import REPOSITORY
from ..support.ros1 import LIMIT, Bridge, wait_for
from ..support.standby import file_of, words_of

pytestmark = pytest.mark.skipif(watchdog.ALARM is None, reason="the extension was not compiled")
BUSY = 3
"""The factor by which steps may take longer than on an idle machine."""


class BlockedBridge:
    """A bridge whose backend blocks in the given call after `block()`."""

    def __init__(self, folder: Path, space: str, call: str, gil: str) -> None:
        self.topics = {name: f"{space}/{name}" for name in ("in", "out", "blocked")}
        self.trigger = folder / "trigger"
        entries = (("in", "to_plc"), ("out", "from_plc"), ("blocked", "from_plc"))
        (folder / "shmgen.toml").write_text(
            "[bridge]\ndiagnostics = 0\n"
            + "".join(
                f'[[topics]]\ntopic = "{space}/{name}"\ntype = "std_msgs/Bool"\ndirection = "{direction}"\ndepth = 8\n'
                for name, direction in entries
            )
        )
        self.command = [
            sys.executable,
            str(REPOSITORY / "tests/bridge/blocking_bridge.py"),
            call,
            gil,
            str(self.trigger),
        ]
        self.folder = folder
        self.start()

    def start(self) -> None:
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        self.process = subprocess.Popen(self.command, cwd=self.folder, **streams)  # type: ignore[call-overload]
        self.bridge = Bridge(self.process)

    def block(self) -> None:
        self.trigger.touch()

    def heartbeat(self, name: str = "in") -> int:
        with words_of(file_of(self.topics[name])) as words:
            return int(words[h.HEARTBEAT])

    def publish(self, name: str) -> None:
        kind = Session(load(self.folder / "shmgen.toml", "shmgen.toml", Report())).message("std_msgs/Bool")
        with publisher(kind, self.topics[name], 8) as writer:
            writer.publish(kind())

    def wait_for_end(self, seconds: float) -> int:
        """Return the exit code. Fail if the process runs longer than `seconds`."""
        try:
            return self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            pytest.fail(f"no end within {seconds} s\n{''.join(self.bridge.lines)}")


@pytest.fixture
def start_blocked(tmp_path: Path, space: str) -> Iterator[Callable[..., BlockedBridge]]:
    bridges: list[BlockedBridge] = []

    def start(call: str, gil: str, at_once: bool = False) -> BlockedBridge:
        if at_once:
            (tmp_path / "trigger").touch()
        bridges.append(BlockedBridge(tmp_path, space, call, gil))
        return bridges[-1]

    yield start
    for blocked_bridge in bridges:
        blocked_bridge.process.kill()
        blocked_bridge.process.communicate()


@pytest.mark.sample("[publish]")
@pytest.mark.parametrize("call", ["publish", "discover"])
def test_blocked_call_with_the_gil_ends_the_process(start_blocked: Callable[..., BlockedBridge], call: str) -> None:
    """Print all stacks and exit. After a restart, the topics are served again within seconds."""
    run = start_blocked(call, "held")
    run.bridge.wait_for_line("^running")
    run.block()
    if call == "publish":
        run.publish("blocked")
    assert run.wait_for_end(watchdog.STALL_LIMIT + 10) == 1
    run.bridge.wait_for_line(r"blocking_bridge.py.* in block")
    run.bridge.wait_for_line("^Timeout")
    run.process.communicate()
    run.trigger.unlink()
    run.start()
    started_at = time.monotonic()
    run.bridge.wait_for_line("^running")
    before = run.heartbeat()
    wait_for(lambda: run.heartbeat() != before, "a heartbeat")
    assert time.monotonic() - started_at < 4 * BUSY


@pytest.mark.parametrize(("number", "gil"), [(signal.SIGTERM, "held"), (signal.SIGINT, "free")])
def test_signal_ends_a_blocked_process(
    start_blocked: Callable[..., BlockedBridge], number: signal.Signals, gil: str
) -> None:
    run = start_blocked("discover", gil)
    run.bridge.wait_for_line("^running")
    run.block()
    time.sleep(0.5)
    started_at = time.monotonic()
    run.process.send_signal(number)
    assert run.wait_for_end(watchdog.STOP_LIMIT + 3) == -signal.SIGALRM
    assert time.monotonic() - started_at > 1
    run.bridge.wait_for_line(r"blocking_bridge.py.* in block")


@pytest.mark.slow
def test_signal_ends_a_process_blocked_in_close(start_blocked: Callable[..., BlockedBridge]) -> None:
    run = start_blocked("close", "held")
    run.bridge.wait_for_line("^running")
    run.block()
    run.process.send_signal(signal.SIGTERM)
    assert run.wait_for_end(watchdog.STOP_LIMIT + 3) == 1
    run.bridge.wait_for_line(r"blocking_bridge.py.* in block")


def test_blocked_publish_stops_no_other_topic(start_blocked: Callable[..., BlockedBridge]) -> None:
    run = start_blocked("publish", "free")
    run.bridge.wait_for_line("^running")
    run.block()
    run.publish("blocked")
    run.bridge.wait_for_line("/blocked: a ROS call has blocked this topic for 0.5 s")
    before = run.heartbeat()
    run.publish("out")
    run.bridge.wait_for_line(f"sent {run.topics['out']}")
    wait_for(lambda: run.heartbeat() != before, "a heartbeat")
    run.process.send_signal(signal.SIGTERM)
    assert run.wait_for_end(3 * BUSY) == 0


def test_blocked_creation_stops_no_other_topic(start_blocked: Callable[..., BlockedBridge]) -> None:
    run = start_blocked("create", "free", at_once=True)
    run.bridge.wait_for_line("/blocked: ROS did not connect this entry within")
    run.bridge.wait_for_line("^running")
    run.publish("out")
    run.bridge.wait_for_line(f"sent {run.topics['out']}")
    run.process.send_signal(signal.SIGTERM)
    assert run.wait_for_end(3 * BUSY) == 0


FLOOD = """
import os, signal
from shmgen.bridge.run import _Signals
signals = _Signals()
if not (child := os.fork()):
    for _ in range(50_000):
        os.kill(os.getppid(), signal.SIGUSR1)
    os._exit(0)
while os.waitpid(child, os.WNOHANG) == (0, 0):
    signals.stop.wait(0)
    signals.counters.clear()
"""


def test_flood_of_signals_does_not_deadlock_the_bridge() -> None:
    """Send many signals: a handler runs in the main thread and must not need a lock that this thread holds."""
    subprocess.run([sys.executable, "-c", FLOOD], check=True, timeout=LIMIT)
