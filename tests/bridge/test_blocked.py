"""A library that blocks, with the GIL held or without, ends the bridge or one topic, and never stops it silently."""

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
"""How many times longer than on a quiet machine everything may take."""


class Blocked:
    """A bridge whose backend blocks in one call as soon as `block` is called."""

    def __init__(self, folder: Path, space: str, call: str, held: str) -> None:
        self.topics = {name: f"{space}/{name}" for name in ("in", "out", "blocked")}
        self.trigger = folder / "trigger"
        entries = (("in", "to_plc"), ("out", "from_plc"), ("blocked", "from_plc"))
        (folder / "shmgen.toml").write_text(
            "[bridge]\ndiagnostics = 0\n"
            + "".join(
                f'[[topics]]\ntopic = "{space}/{name}"\ntype = "std_msgs/Bool"\ndirection = "{way}"\ndepth = 8\n'
                for name, way in entries
            )
        )
        self.command = [
            sys.executable,
            str(REPOSITORY / "tests/bridge/blocking_bridge.py"),
            call,
            held,
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

    def ended(self, seconds: float) -> int:
        """Return the exit code, which must come within so many seconds."""
        try:
            return self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            pytest.fail(f"no end within {seconds} s\n{''.join(self.bridge.lines)}")


@pytest.fixture
def blocked(tmp_path: Path, space: str) -> Iterator[Callable[..., Blocked]]:
    made: list[Blocked] = []

    def make(call: str, held: str, at_once: bool = False) -> Blocked:
        if at_once:
            (tmp_path / "trigger").touch()
        made.append(Blocked(tmp_path, space, call, held))
        return made[-1]

    yield make
    for one in made:
        one.process.kill()
        one.process.communicate()


@pytest.mark.slow
@pytest.mark.parametrize("call", ["publish", "discover"])
def test_a_call_that_holds_the_gil_ends_the_process(blocked: Callable[..., Blocked], call: str) -> None:
    """All stacks are printed, and a restart brings the topics back within four seconds."""
    one = blocked(call, "held")
    one.bridge.wait_for_line("^running")
    one.block()
    if call == "publish":
        one.publish("blocked")
    assert one.ended(watchdog.STALL_LIMIT + 10) == 1
    one.bridge.wait_for_line(r"blocking_bridge.py.* in block")
    one.bridge.wait_for_line("^Timeout")
    one.process.communicate()
    one.trigger.unlink()
    one.start()
    begun = time.monotonic()
    one.bridge.wait_for_line("^running")
    before = one.heartbeat()
    wait_for(lambda: one.heartbeat() != before, "a heartbeat")
    assert time.monotonic() - begun < 4 * BUSY


@pytest.mark.parametrize(("number", "held"), [(signal.SIGTERM, "held"), (signal.SIGINT, "free")])
def test_a_signal_ends_a_process_that_a_library_blocks(
    blocked: Callable[..., Blocked], number: signal.Signals, held: str
) -> None:
    one = blocked("discover", held)
    one.bridge.wait_for_line("^running")
    one.block()
    time.sleep(0.5)
    begun = time.monotonic()
    one.process.send_signal(number)
    assert one.ended(watchdog.STOP_LIMIT + 3) == -signal.SIGALRM
    assert time.monotonic() - begun > 1
    one.bridge.wait_for_line(r"blocking_bridge.py.* in block")


@pytest.mark.slow
def test_a_signal_ends_a_process_whose_library_blocks_while_it_leaves(blocked: Callable[..., Blocked]) -> None:
    one = blocked("close", "held")
    one.bridge.wait_for_line("^running")
    one.block()
    one.process.send_signal(signal.SIGTERM)
    assert one.ended(watchdog.STOP_LIMIT + 3) == 1
    one.bridge.wait_for_line(r"blocking_bridge.py.* in block")


def test_a_blocked_publish_stops_no_other_topic(blocked: Callable[..., Blocked]) -> None:
    one = blocked("publish", "free")
    one.bridge.wait_for_line("^running")
    one.block()
    one.publish("blocked")
    one.bridge.wait_for_line("/blocked: a call of ROS has blocked for 0.5 s")
    before = one.heartbeat()
    one.publish("out")
    one.bridge.wait_for_line(f"sent {one.topics['out']}")
    wait_for(lambda: one.heartbeat() != before, "a heartbeat")
    one.process.send_signal(signal.SIGTERM)
    assert one.ended(3 * BUSY) == 0


def test_ends_that_ros_does_not_create_stop_no_other_topic(blocked: Callable[..., Blocked]) -> None:
    one = blocked("create", "free", at_once=True)
    one.bridge.wait_for_line("/blocked: ROS has not connected it within")
    one.bridge.wait_for_line("^running")
    one.publish("out")
    one.bridge.wait_for_line(f"sent {one.topics['out']}")
    one.process.send_signal(signal.SIGTERM)
    assert one.ended(3 * BUSY) == 0


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


def test_a_signal_between_any_two_instructions_blocks_nothing() -> None:
    """Handlers run in the main thread, also while it waits or clears: a lock that it holds then must not be needed."""
    subprocess.run([sys.executable, "-c", FLOOD], check=True, timeout=LIMIT)
