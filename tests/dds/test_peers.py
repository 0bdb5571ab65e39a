"""Messages to and from programs that are not ours: on Fast DDS, ROS 2's default, and on Cyclone's C library."""

from __future__ import annotations

import re
import signal
import time
from dataclasses import replace
from pathlib import Path
from queue import Queue
from typing import Any

import numpy
import pytest

from shmgen.bridge.backend import RosPublisher, Wire
from shmgen.bridge.codec.type_identity import type_name
from shmgen.bridge.dds import backend
from shmgen.bridge.dds.types import topic_name
from shmgen.core.model import Schema

from ..support.schemas import plain
from .conftest import TYPES, Taken, until, wire
from .peers import running
from .values import values

JOINT_STATE = "sensor_msgs/JointState"
SAID = "12.345678901 base shoulder elbow 0.5 -1.25 | 0 1"
"""The one joint state that a peer says of itself, as it prints those it hears."""


def words(wire: Wire, back: Wire | None = None) -> list[str]:
    """What a peer is to do: to send back, or to say."""
    names = [topic_name(wire.name), topic_name(back.name)] if back else ["-", topic_name(wire.name)]
    return [type_name(wire.type), *names]


def test_what_a_peer_sends_back_is_what_was_sent(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str
) -> None:
    drawn = values(TYPES)
    ends: list[tuple[Wire, RosPublisher, Queue[Any]]] = []
    tasks: list[str] = []
    for number, request in enumerate(TYPES):
        there, back = wire(schema, f"{topic}/there{number}", request), wire(schema, f"{topic}/back{number}", request)
        came: Queue[Any] = Queue()
        graph.subscribe(back, Taken(came.put))
        ends.append((there, graph.publisher(there), came))
        tasks += words(there, back)
    with running(peer, domain, "reliable", "volatile", *tasks):
        for there, outlet, came in ends:
            until(lambda outlet=outlet, came=came: outlet.send(outlet.new()) or not came.empty())
            for seed in range(5):
                message = drawn.fill(there.type, outlet.new(), seed)
                outlet.send(message)
                wanted, answer = plain(message), plain(came.get(timeout=5))
                while seed == 0 and answer != wanted:  # those sent until both sides knew each other
                    answer = plain(came.get(timeout=5))
                assert answer == wanted, there.type


@pytest.mark.parametrize("qos", ["reliable", "best_effort"])
def test_a_peer_reads_our_values_and_we_read_its(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str, qos: str
) -> None:
    there = wire(schema, f"{topic}/there", JOINT_STATE, qos=qos)
    back = wire(schema, f"{topic}/back", JOINT_STATE, qos=qos)
    said = wire(schema, f"{topic}/said", JOINT_STATE, qos=qos)
    came: Queue[Any] = Queue()
    heard: Queue[Any] = Queue()
    graph.subscribe(back, Taken(came.put))
    graph.subscribe(said, Taken(heard.put))
    outlet = graph.publisher(there)
    with running(peer, domain, qos, "volatile", *words(there, back), *words(said)) as program:
        state = heard.get(timeout=10)
        assert_said(state)
        until(lambda: outlet.send(state) or not came.empty())
        assert_said(came.get())
        program.wait_for_line(f"^took {re.escape(SAID)}$")


def test_who_comes_late_hears_the_newest(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str
) -> None:
    there, back, said = (wire(schema, f"{topic}/{name}", JOINT_STATE, latch=True) for name in ("there", "back", "said"))
    outlet = graph.publisher(there)
    for second in range(3):
        state = outlet.new()
        state.header.stamp.sec = second
        outlet.send(state)
    with running(peer, domain, "reliable", "latch", *words(there, back), *words(said)) as program:
        program.wait_for_line("^took 2[.]")  # before we listen to either topic
        assert not [line for line in program.lines if re.match("took [01][.]", line)]
        came: Queue[Any] = Queue()
        heard: Queue[Any] = Queue()
        graph.subscribe(back, Taken(came.put))
        graph.subscribe(said, Taken(heard.put))
        assert came.get(timeout=10).header.stamp.sec == 2
        assert_said(heard.get(timeout=10))


def test_a_peer_that_went_and_came_is_known_again(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str
) -> None:
    said = wire(schema, topic, JOINT_STATE)
    came: Queue[Any] = Queue()
    graph.subscribe(said, Taken(came.put))
    for _ in range(2):
        with running(peer, domain, "reliable", "volatile", *words(said)) as program:
            assert_said(came.get(timeout=10))
            program.kill()
        while not came.empty():
            came.get()


def test_a_peer_of_another_reliability_is_adopted_or_reported(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str, logged: list[str]
) -> None:
    said = wire(schema, topic, JOINT_STATE, qos="reliable")
    fixed = graph.subscribe(said, Taken(lambda message: logged.append("a message")))
    with running(peer, domain, "best_effort", "volatile", *words(said)):
        until(fixed.qos_problem)
        assert "a publisher is best effort and volatile" in fixed.qos_problem()
        came: Queue[Any] = Queue()
        open_ = graph.subscribe(replace(said, qos="auto"), Taken(came.put))
        until(lambda: open_.qos_problem() or not came.empty())
        assert not open_.qos_problem()
    until(lambda: not fixed.qos_problem(), 30)
    assert "a message" not in logged


def assert_said(state: Any) -> None:
    stamp = state.header.stamp
    numbers = [len(state.velocity), len(state.effort)]
    shown = [f"{stamp.sec}.{stamp.nanosec:09}", state.header.frame_id, *state.name, *state.position, "|", *numbers]
    assert " ".join(map(str, shown)) == SAID


def test_a_reliable_peer_that_stands_still_holds_nobody_up(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str
) -> None:
    large_one = "std_msgs/ByteMultiArray"
    there, back = (wire(schema, f"{topic}/{name}", large_one, sample_size=100_000) for name in ("there", "back"))
    came: Queue[Any] = Queue()
    graph.subscribe(back, Taken(came.put))
    outlet = graph.publisher(there)
    large = outlet.new()
    large.data = numpy.zeros(100_000, dtype=numpy.uint8)
    with running(peer, domain, "reliable", "volatile", *words(there, back)) as program:
        until(lambda: outlet.send(large) or not came.empty())
        program.process.send_signal(signal.SIGSTOP)
        longest = 0.0
        for _ in range(500):
            begun = time.monotonic()
            outlet.send(large)
            longest = max(longest, time.monotonic() - begun)
        assert longest < 1  # about 0.1 ms each, and what a busy machine adds
        program.process.send_signal(signal.SIGCONT)
        while not came.empty():
            came.get()
        until(lambda: outlet.send(large) or not came.empty())
