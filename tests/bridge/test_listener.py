"""Test the thread that serves many topics from the PLC: an error of one topic does not disturb the others."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from shmgen.bridge import listener, sides
from shmgen.bridge.common.counters import Counters, describe
from shmgen.bridge.listener import Listener
from shmgen.bridge.topics import FromPlc
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.session import Session
from shmgen.runtime import LayoutMismatch, Subscriber

from ..runtime.messages import PosePublisher, PoseSubscriber, pose

LIMIT = 60
"""Seconds after which an expected event counts as missing on any machine."""


class Topic:
    """A topic that a listener serves, with its writer, and a record of the calls and samples."""

    def __init__(self, topic: str, take_order: list[Topic]) -> None:
        self.log: list[str] = []
        self.counters = Counters(topic, self.log.append)
        self.end = self
        self.reader = PoseSubscriber(topic, depth=9)
        self.writer = PosePublisher(topic, depth=9)
        self.received: list[float] = []
        self.threads: set[int] = set()
        self.lookups = self.takes = 0
        self.is_ready: Callable[[], bool] = lambda: True
        self.after_take: Callable[[], object] = lambda: None
        self.open_errors: list[Exception] = []
        self._take_order = take_order

    @property
    def current(self) -> Subscriber[Any]:
        self.lookups += 1
        if self.open_errors:
            raise self.open_errors.pop()
        return self.reader

    def take(self, reader: Subscriber[Any]) -> bool:
        assert reader is self.reader
        self.takes += 1
        self.threads.add(threading.get_ident())
        if not self.is_ready():
            return False
        samples = reader.read_all()
        self.received += [sample.position.x for sample in samples]
        self._take_order.append(self)
        self.after_take()
        return bool(samples)

    def report(self, error: Exception) -> None:
        self.counters.log_rate_limited(describe(error))

    def publish(self, number: float) -> None:
        self.writer.publish(pose(number))


@pytest.fixture
def stopping() -> threading.Event:
    return threading.Event()


@pytest.fixture
def take_order() -> list[Topic]:
    """The topics in the order in which the listener took their samples."""
    return []


@pytest.fixture
def topics(topic: str, stopping: threading.Event, take_order: list[Topic]) -> Iterator[list[Topic]]:
    """Three topics that a listener serves."""
    served = Listener(stopping)
    opened = [Topic(f"{topic}/t{number}", take_order) for number in range(3)]
    with ExitStack() as stack:
        for served_topic in opened:
            stack.enter_context(served_topic.reader)
            stack.enter_context(served_topic.writer)
            served.add(served_topic)
        wait_until(lambda: len(served._readers) == len(opened))
        yield opened
        stopping.set()
        wait_until(lambda: not served._thread.is_alive())


def wait_until(condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_one_thread_serves_all_topics(topics: list[Topic]) -> None:
    for number in range(5):
        for topic in topics:
            topic.publish(number)
    wait_until(lambda: all(topic.received == [0, 1, 2, 3, 4] for topic in topics))
    assert len(set.union(*(topic.threads for topic in topics))) == 1


@pytest.mark.parametrize(
    ("error", "message"),
    [(LayoutMismatch("odd"), "odd"), (OSError("odd"), "odd"), (KeyError("odd"), "KeyError: 'odd'")],
)
def test_failed_topic_is_logged_and_the_others_continue(
    topics: list[Topic], error: Exception, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "RETRY_INTERVAL", 3600)
    monkeypatch.setattr(listener, "POLL_INTERVAL", 0.01)

    def fail() -> bool:
        raise error

    bad, *others = topics
    bad.is_ready = fail
    bad.publish(1)
    wait_until(lambda: bad.log)
    assert bad.log == [f"{bad.counters.topic}: {message}"]
    for number in range(3):
        for topic in others:
            topic.publish(number)
            wait_until(lambda topic=topic, number=number: topic.received[-1:] == [number])
    lookups = others[0].lookups
    wait_until(lambda: others[0].lookups > lookups + 2)
    assert (bad.takes, bad.received) == (1, [])


def test_closed_subscriber_is_logged(topics: list[Topic]) -> None:
    bad, good, _ = topics
    bad.reader.close()
    wait_until(lambda: bad.log)
    assert "this subscriber is closed" in bad.log[0]
    good.publish(1)
    wait_until(lambda: good.received == [1])


def test_topic_that_cannot_be_opened_is_retried(topics: list[Topic], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listener, "RETRY_INTERVAL", 0.01)
    bad, good, _ = topics
    bad.open_errors = [OSError("later"), LayoutMismatch("first")]
    wait_until(lambda: not bad.open_errors)
    good.publish(1)
    bad.publish(2)
    wait_until(lambda: good.received == [1] and bad.received == [2])
    assert bad.log == [f"{bad.counters.topic}: first"]


def test_locked_topic_neither_spins_nor_delays_the_others(topics: list[Topic]) -> None:
    bad, good, _ = topics
    bad.is_ready = lambda: False
    bad.publish(1)
    wait_until(lambda: bad.takes)
    started_at, before = time.monotonic(), bad.takes
    for number in range(50):
        good.publish(number)
        wait_until(lambda number=number: good.received[-1:] == [number])
    turns = 50 + (time.monotonic() - started_at) / 0.001
    assert bad.takes - before <= turns + 2
    bad.is_ready = lambda: True
    wait_until(lambda: bad.received == [1])


def test_busy_topic_does_not_starve_the_others(topics: list[Topic], take_order: list[Topic]) -> None:
    greedy, good, _ = topics

    def publish_more() -> None:
        if greedy.takes < 100:
            greedy.publish(greedy.takes)
        if greedy.takes == 10:
            good.publish(10)

    greedy.after_take = publish_more
    greedy.publish(0)
    wait_until(lambda: greedy.received == list(range(100)) and good.received)
    assert take_order.index(good) == 11


def test_topic_added_later_is_served_too(topic: str, stopping: threading.Event, take_order: list[Topic]) -> None:
    served, first, late = Listener(stopping), Topic(f"{topic}/first", take_order), Topic(f"{topic}/late", take_order)
    with first.reader, first.writer, late.reader, late.writer:
        for added in (first, late):
            served.add(added)
            added.publish(1)
            wait_until(lambda added=added: added.received == [1])
        assert first.threads == late.threads
        stopping.set()
        wait_until(lambda: not served._thread.is_alive())


def test_topics_without_a_rate_share_a_thread(tmp_path: Path, topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Use a thread for each topic if a thread cannot wait for many."""
    (tmp_path / "shmgen.toml").write_text(
        "".join(
            f'[[topics]]\ntopic = "{topic}/{name}"\ntype = "std_msgs/Bool"\ndirection = "from_plc"\n{keys}\n'
            for name, keys in (("a", ""), ("b", "latch = true"), ("c", "rate = 5"), ("d", "rate = 5"))
        )
    )
    session = Session(load(tmp_path / "shmgen.toml", "shmgen.toml", Report()))
    for is_possible, threads in ((True, 3), (False, 4)):
        monkeypatch.setattr(sides, "can_wait_for_many", lambda is_possible=is_possible: is_possible)
        all_sides = sides.Sides(print)
        all_sides.open(session)
        topics = [side for side in all_sides if isinstance(side, FromPlc)]
        assert len({side._listener for side in topics}) == threads
        assert (topics[0]._listener is topics[1]._listener) == is_possible
        all_sides.close()
