"""One thread for many topics from the PLC: what one of them meets is not the others' affair."""

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

SOON = 60
"""Seconds: whatever takes longer is late on any machine."""


class Topic:
    """What a listener hears, its writer, and what becomes of it."""

    def __init__(self, topic: str, heard: list[Topic]) -> None:
        self.told: list[str] = []
        self.counters = Counters(topic, self.told.append)
        self.reader = PoseSubscriber(topic, depth=9)
        self.writer = PosePublisher(topic, depth=9)
        self.got: list[float] = []
        self.threads: set[int] = set()
        self.looks = self.tries = 0
        self.meets: Callable[[], bool] = lambda: True
        self.then: Callable[[], object] = lambda: None
        self.cannot: list[Exception] = []
        self._heard = heard

    @property
    def subscriber(self) -> Subscriber[Any]:
        self.looks += 1
        if self.cannot:
            raise self.cannot.pop()
        return self.reader

    def take(self, reader: Subscriber[Any]) -> bool:
        assert reader is self.reader
        self.tries += 1
        self.threads.add(threading.get_ident())
        if not self.meets():
            return False
        samples = reader.read_all()
        self.got += [sample.position.x for sample in samples]
        self._heard.append(self)
        self.then()
        return bool(samples)

    def report(self, error: Exception) -> None:
        self.counters.log_rate_limited(describe(error))

    def say(self, number: float) -> None:
        self.writer.publish(pose(number))


@pytest.fixture
def stopping() -> threading.Event:
    return threading.Event()


@pytest.fixture
def heard() -> list[Topic]:
    """Which topics had samples taken, in order."""
    return []


@pytest.fixture
def topics(topic: str, stopping: threading.Event, heard: list[Topic]) -> Iterator[list[Topic]]:
    """Three, which a listener hears."""
    ear = Listener(stopping)
    made = [Topic(f"{topic}/t{number}", heard) for number in range(3)]
    with ExitStack() as stack:
        for one in made:
            stack.enter_context(one.reader)
            stack.enter_context(one.writer)
            ear.add(one)
        soon(lambda: len(ear._readers) == len(made))
        yield made
        stopping.set()
        soon(lambda: not ear._thread.is_alive())


def soon(said: Callable[[], Any]) -> None:
    end = time.monotonic() + SOON
    while not said():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_one_thread_hears_all(topics: list[Topic]) -> None:
    for number in range(5):
        for one in topics:
            one.say(number)
    soon(lambda: all(one.got == [0, 1, 2, 3, 4] for one in topics))
    assert len(set.union(*(one.threads for one in topics))) == 1


@pytest.mark.parametrize(
    ("error", "said"), [(LayoutMismatch("odd"), "odd"), (OSError("odd"), "odd"), (KeyError("odd"), "KeyError: 'odd'")]
)
def test_one_that_fails_is_told_and_tried_again_while_the_others_go_on(
    topics: list[Topic], error: Exception, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "RETRY_INTERVAL", 3600)
    monkeypatch.setattr(listener, "POLL_INTERVAL", 0.01)

    def fail() -> bool:
        raise error

    bad, *others = topics
    bad.meets = fail
    bad.say(1)
    soon(lambda: bad.told)
    assert bad.told == [f"{bad.counters.topic}: {said}"]
    for number in range(3):
        for one in others:
            one.say(number)
            soon(lambda one=one, number=number: one.got[-1:] == [number])
    looks = others[0].looks
    soon(lambda: others[0].looks > looks + 2)
    assert (bad.tries, bad.got) == (1, [])


def test_one_that_cannot_be_waited_for_is_told(topics: list[Topic]) -> None:
    bad, good, _ = topics
    bad.reader.close()
    soon(lambda: bad.told)
    assert "this subscriber is closed" in bad.told[0]
    good.say(1)
    soon(lambda: good.got == [1])


def test_one_that_cannot_be_opened_is_tried_again(topics: list[Topic], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listener, "RETRY_INTERVAL", 0.01)
    bad, good, _ = topics
    bad.cannot = [OSError("later"), LayoutMismatch("first")]
    soon(lambda: not bad.cannot)
    good.say(1)
    bad.say(2)
    soon(lambda: good.got == [1] and bad.got == [2])
    assert bad.told == [f"{bad.counters.topic}: first"]


def test_one_locked_out_neither_spins_nor_holds_up_the_others(topics: list[Topic]) -> None:
    bad, good, _ = topics
    bad.meets = lambda: False
    bad.say(1)
    soon(lambda: bad.tries)
    begun, before = time.monotonic(), bad.tries
    for number in range(50):
        good.say(number)
        soon(lambda number=number: good.got[-1:] == [number])
    turns = 50 + (time.monotonic() - begun) / 0.001
    assert bad.tries - before <= turns + 2
    bad.meets = lambda: True
    soon(lambda: bad.got == [1])


def test_one_that_never_ends_does_not_starve_the_others(topics: list[Topic], heard: list[Topic]) -> None:
    greedy, good, _ = topics

    def more() -> None:
        if greedy.tries < 100:
            greedy.say(greedy.tries)
        if greedy.tries == 10:
            good.say(10)

    greedy.then = more
    greedy.say(0)
    soon(lambda: greedy.got == list(range(100)) and good.got)
    assert heard.index(good) == 11


def test_who_comes_later_is_heard_too(topic: str, stopping: threading.Event, heard: list[Topic]) -> None:
    ear, first, late = Listener(stopping), Topic(f"{topic}/first", heard), Topic(f"{topic}/late", heard)
    with first.reader, first.writer, late.reader, late.writer:
        for one in (first, late):
            ear.add(one)
            one.say(1)
            soon(lambda one=one: one.got == [1])
        assert first.threads == late.threads
        stopping.set()
        soon(lambda: not ear._thread.is_alive())


def test_topics_share_a_thread_but_those_with_a_rate(
    tmp_path: Path, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And none does where a thread cannot wait for many."""
    (tmp_path / "shmgen.toml").write_text(
        "".join(
            f'[[topics]]\ntopic = "{topic}/{name}"\ntype = "std_msgs/Bool"\ndirection = "from_plc"\n{keys}\n'
            for name, keys in (("a", ""), ("b", "latch = true"), ("c", "rate = 5"), ("d", "rate = 5"))
        )
    )
    session = Session(load(tmp_path / "shmgen.toml", "shmgen.toml", Report()))
    for can, threads in ((True, 3), (False, 4)):
        monkeypatch.setattr(sides, "can_wait_for_many", lambda can=can: can)
        carried = sides.Sides(print)
        carried.open(session)
        topics = [side for side in carried if isinstance(side, FromPlc)]
        assert len({side._listener for side in topics}) == threads
        assert (topics[0]._listener is topics[1]._listener) == can
        carried.close()
