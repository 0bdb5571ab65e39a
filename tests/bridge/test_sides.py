"""Test all topics of a bridge together: errors stay within one topic, and a reload changes all topics or none."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.bridge.backend import Backend, RosClient, RosPublisher, RosSubscription
from shmgen.bridge.common.counters import Counters
from shmgen.bridge.sides import Sides
from shmgen.bridge.topics import FromPlc
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import publisher
from shmgen.live.session import Session
from shmgen.runtime import Time

from ..support.ros1 import wait_for
from .test_blocked import BlockedBridge, start_blocked  # noqa: F401
from .test_routes import wait_until


def new_side(name: str, beat: Any, log: list[str]) -> Any:
    return SimpleNamespace(
        beat=beat, counters=Counters(name, log.append), stopping=threading.Event(), stop=lambda: True
    )


def test_error_of_a_topic_stops_no_other_heartbeat() -> None:
    log: list[str] = []
    beats: list[int] = []
    alive: list[int] = []

    def fail() -> None:
        raise KeyError("odd")

    sides = Sides(log.append, lambda: alive.append(1))
    sides._carried = {1: new_side("/a", fail, log), 2: new_side("/b", lambda: beats.append(1), log)}
    try:
        wait_until(lambda: len(beats) > 3 and len(alive) > 3)
    finally:
        sides.stop()
    assert log == ["/a: KeyError: 'odd'"]


class Ros(Backend):
    """A backend that rejects each topic in `rejected` once. `late` lists messages sent after their publisher closed."""

    def __init__(self) -> None:
        super().__init__()
        self.rejected: list[str] = []
        self.takers: dict[str, Any] = {}
        self.sent: list[tuple[str, bool]] = []
        self.late: list[str] = []
        self.pause = 0.0

    def publisher(self, wire: Any) -> RosPublisher:
        self._check(wire.name)
        destroyed = threading.Event()

        def send(message: Any) -> None:
            time.sleep(self.pause)
            if destroyed.is_set():
                self.late.append(wire.name)
            self.sent.append((wire.name, message.data))

        self.undo.append(destroyed.set)
        return RosPublisher(lambda: SimpleNamespace(data=False), send)

    def subscribe(self, wire: Any, take: Any, errors: Any) -> RosSubscription:
        self._check(wire.name)
        self.takers[wire.name] = take
        self.undo.append(lambda: self.takers.pop(wire.name))
        return RosSubscription(lambda: SimpleNamespace(data=False))

    def now(self) -> Time:
        return Time(1, 2)

    def serve(self, wire: Any, answer: Any, errors: Any) -> None:
        raise NotImplementedError

    def client(self, wire: Any) -> RosClient:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError

    def _check(self, topic: str) -> None:
        if topic in self.rejected:
            self.rejected.remove(topic)
            raise ValueError(f"{topic}: not installed")


class Stage:
    """Topics with a backend in this process, and their configuration."""

    def __init__(self, folder: Path, space: str) -> None:
        self.folder, self.space = folder, space
        self.log: list[str] = []
        self.ros, self.sides = Ros(), Sides(self.log.append)

    def session(self, **topics: str) -> Session:
        """Configure topics by name. The values are keys of shmgen.toml, separated by semicolons."""
        text = "".join(
            f'[[topics]]\ntopic = "{self.space}/{name}"\ntype = "std_msgs/Bool"\n{keys.replace("; ", chr(10))}\n'
            for name, keys in topics.items()
        )
        (self.folder / "shmgen.toml").write_text(text)
        return Session(load(self.folder / "shmgen.toml", "shmgen.toml", Report()))

    def start(self, **topics: str) -> None:
        self.sides.open(self.session(**topics))
        self.sides.start(self.ros)

    def change(self, **topics: str) -> None:
        self.sides.change(self.session(**topics), self.ros)

    def counters(self) -> dict[str, str]:
        return {side.about.name.removeprefix(f"{self.space}/"): str(side.counters) for side in self.sides}

    def take(self, name: str) -> None:
        self.ros.takers[f"{self.space}/{name}"](SimpleNamespace(data=True))


@pytest.fixture
def stage(tmp_path: Path, space: str) -> Iterator[Stage]:
    created_stage = Stage(tmp_path, space)
    yield created_stage
    created_stage.sides.close()


def test_reload_keeps_unchanged_topics_and_all_counters(stage: Stage) -> None:
    stage.start(a="", b="", c="")
    untouched = next(iter(stage.sides))
    for name in "abc":
        stage.take(name)
    stage.change(a="", b="stale = 3")
    assert next(iter(stage.sides)) is untouched
    for name in "ab":
        stage.take(name)
    stage.change(a="", b="stale = 3", c="")
    stage.take("c")
    assert stage.counters() == {"a": "2 passed", "b": "2 passed", "c": "2 passed"}
    assert f"{stage.space}/c: removed from shmgen.toml, no longer carried: 1 passed" in stage.log


def test_reload_counts_every_sample_of_a_changed_topic(stage: Stage) -> None:
    stage.start(a='direction = "from_plc"; depth = 8')
    stop, sent = threading.Event(), 0
    (kind,) = {side.route.kind for side in stage.sides if isinstance(side, FromPlc)}

    def write() -> None:
        nonlocal sent
        while not stop.wait(0.001):
            writer.publish(kind(data=True))
            sent += 1

    with publisher(kind, f"{stage.space}/a", 8) as writer:
        thread = threading.Thread(target=write)
        thread.start()
        for stale in range(3, 8):
            stage.change(a=f'direction = "from_plc"; depth = 8; stale = {stale}')
        stop.set()
        thread.join()
        (counters,) = (side.counters for side in stage.sides)
        wait_until(lambda: counters.passed + counters.missed >= sent)
    assert counters.passed + counters.missed == sent
    assert counters.passed


@pytest.mark.parametrize("rejected", ["b", "new"])
def test_reload_rejected_by_ros_changes_nothing(stage: Stage, rejected: str) -> None:
    stage.start(a="", b="", c="")
    for name in "abc":
        stage.take(name)
    stage.ros.rejected.append(f"{stage.space}/{rejected}")
    with pytest.raises(ValueError, match="not installed"):
        stage.change(a="", b="stale = 3", new="")
    for name in "abc":
        stage.take(name)
    assert stage.counters() == {"a": "2 passed", "b": "2 passed", "c": "2 passed"}
    assert set(stage.ros.takers) == {f"{stage.space}/{name}" for name in "abc"}


def test_removal_after_a_rejected_reload_closes_the_topic(stage: Stage) -> None:
    stage.start(a="", b="")
    kind = stage.session(b="").message("std_msgs/Bool")
    stage.ros.rejected.append(f"{stage.space}/new")
    with pytest.raises(ValueError, match="not installed"):
        stage.change(a="", b="stale = 3", new="")
    stage.change(a="")
    with publisher(kind, f"{stage.space}/b", 1) as writer:  # raises RegionInUse if the bridge has not closed it
        writer.publish(kind())


def test_nothing_is_sent_through_a_removed_publisher(stage: Stage) -> None:
    """Finish sending the current message first, even if ROS is slow, and count the others."""
    keys = 'direction = "from_plc"; depth = 32'
    stage.start(a=keys, b="")
    kind = stage.session(a=keys, b="").message("std_msgs/Bool")
    stage.ros.pause = 0.7
    with publisher(kind, f"{stage.space}/a", 32) as writer:
        for _ in range(4):
            writer.publish(kind())
        wait_until(lambda: stage.sides._counters and next(iter(stage.sides)).counters.newest)
        stage.change(b="")
    time.sleep(1.5)
    assert not stage.ros.late
    (counters,) = (counter for (_, name), counter in stage.sides._counters.items() if name.endswith("/a"))
    assert counters.passed + counters.missed == 4


def test_stop_ends_a_reload(stage: Stage) -> None:
    stage.start(a="")
    stage.ros._check = lambda topic: time.sleep(1000)  # type: ignore[method-assign]
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    stage.sides.is_over = stop.is_set
    started_at = time.monotonic()
    stage.sides.change(stage.session(a="", b=""), stage.ros)  # type: ignore[arg-type]
    assert time.monotonic() - started_at < 3


def test_reload_retries_a_file_that_was_empty(start_blocked: Callable[..., BlockedBridge]) -> None:  # noqa: F811
    """Reject an empty file without closing a topic or resetting a counter."""
    run = start_blocked("close", "free")
    file = run.folder / "shmgen.toml"
    text = file.read_text()
    run.bridge.wait_for_line("^running")
    run.publish("out")
    run.bridge.counted("1 passed")
    before = run.heartbeat()
    file.write_text("")
    run.process.send_signal(signal.SIGHUP)
    run.bridge.wait_for_line("was not reloaded: no topic, service or action is listed")
    wait_for(lambda: run.heartbeat() != before, "a heartbeat")
    file.write_text("")
    run.process.send_signal(signal.SIGHUP)
    time.sleep(0.1)
    file.write_text(text + f'[[topics]]\ntopic = "{run.topics["in"]}2"\ntype = "std_msgs/Bool"\n')
    run.bridge.wait_for_line("was reloaded: topics: 4")
    run.publish("out")
    run.bridge.counted("2 passed")
    assert not [line for line in run.bridge.lines if "topics: 0" in line]
