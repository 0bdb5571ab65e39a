"""Exchange messages with programs without code of shmgen: on Fast DDS, ROS 2's default, and on Cyclone's C library."""

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
from .conftest import TYPES, Errors, until, wire
from .peers import running
from .values import values

JOINT_STATE = "sensor_msgs/JointState"
PEER_STATE = "12.345678901 base shoulder elbow 0.5 -1.25 | 0 1"
"""The joint state that a peer publishes itself, in the format in which the peer prints received joint states."""


def task(wire: Wire, back: Wire | None = None) -> list[str]:
    """Return a peer's arguments for one task: echo `wire` on `back`, or publish PEER_STATE on `wire`."""
    names = [topic_name(wire.name), topic_name(back.name)] if back else ["-", topic_name(wire.name)]
    return [type_name(wire.type), *names]


def test_peer_echoes_random_messages_unchanged(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str
) -> None:
    random_values = values(TYPES)
    routes: list[tuple[Wire, RosPublisher, Queue[Any]]] = []
    tasks: list[str] = []
    for number, request in enumerate(TYPES):
        sent, back = wire(schema, f"{topic}/there{number}", request), wire(schema, f"{topic}/back{number}", request)
        received: Queue[Any] = Queue()
        graph.subscribe(back, received.put, Errors())
        routes.append((sent, graph.publisher(sent), received))
        tasks += task(sent, back)
    with running(peer, domain, "reliable", "volatile", *tasks):
        for sent, outlet, received in routes:
            until(lambda outlet=outlet, received=received: outlet.send(outlet.new()) or not received.empty())
            for seed in range(5):
                message = random_values.fill(sent.type, outlet.new(), seed)
                outlet.send(message)
                expected, answer = plain(message), plain(received.get(timeout=5))
                while seed == 0 and answer != expected:  # skip messages sent during discovery
                    answer = plain(received.get(timeout=5))
                assert answer == expected, sent.type


@pytest.mark.parametrize("qos", ["reliable", "best_effort"])
def test_peer_and_bridge_read_each_others_values(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str, qos: str
) -> None:
    sent = wire(schema, f"{topic}/there", JOINT_STATE, qos=qos)
    back = wire(schema, f"{topic}/back", JOINT_STATE, qos=qos)
    own = wire(schema, f"{topic}/said", JOINT_STATE, qos=qos)
    received: Queue[Any] = Queue()
    own_states: Queue[Any] = Queue()
    graph.subscribe(back, received.put, Errors())
    graph.subscribe(own, own_states.put, Errors())
    outlet = graph.publisher(sent)
    with running(peer, domain, qos, "volatile", *task(sent, back), *task(own)) as program:
        state = own_states.get(timeout=10)
        assert_is_peer_state(state)
        until(lambda: outlet.send(state) or not received.empty())
        assert_is_peer_state(received.get())
        program.wait_for_line(f"^took {re.escape(PEER_STATE)}$")


def test_late_subscriber_receives_the_newest_message(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str
) -> None:
    sent, back, own = (wire(schema, f"{topic}/{name}", JOINT_STATE, latch=True) for name in ("there", "back", "said"))
    outlet = graph.publisher(sent)
    for second in range(3):
        state = outlet.new()
        state.header.stamp.sec = second
        outlet.send(state)
    with running(peer, domain, "reliable", "latch", *task(sent, back), *task(own)) as program:
        program.wait_for_line("^took 2[.]")  # before this test subscribes to `back` and `own`
        assert not [line for line in program.lines if re.match("took [01][.]", line)]
        received: Queue[Any] = Queue()
        own_states: Queue[Any] = Queue()
        graph.subscribe(back, received.put, Errors())
        graph.subscribe(own, own_states.put, Errors())
        assert received.get(timeout=10).header.stamp.sec == 2
        assert_is_peer_state(own_states.get(timeout=10))


def test_restarted_peer_is_discovered_again(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str
) -> None:
    own = wire(schema, topic, JOINT_STATE)
    received: Queue[Any] = Queue()
    graph.subscribe(own, received.put, Errors())
    for _ in range(2):
        with running(peer, domain, "reliable", "volatile", *task(own)) as program:
            assert_is_peer_state(received.get(timeout=10))
            program.kill()
        while not received.empty():
            received.get()


def test_peer_of_another_reliability_is_adopted_or_reported(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str, logged: list[str]
) -> None:
    own = wire(schema, topic, JOINT_STATE, qos="reliable")
    fixed = graph.subscribe(own, lambda message: logged.append("a message"), Errors())
    with running(peer, domain, "best_effort", "volatile", *task(own)):
        until(fixed.qos_problem)
        assert "a publisher is best effort and volatile" in fixed.qos_problem()
        received: Queue[Any] = Queue()
        adopting = graph.subscribe(replace(own, qos="auto"), received.put, Errors())
        until(lambda: adopting.qos_problem() or not received.empty())
        assert not adopting.qos_problem()
    until(lambda: not fixed.qos_problem(), 30)
    assert "a message" not in logged


def assert_is_peer_state(state: Any) -> None:
    stamp = state.header.stamp
    numbers = [len(state.velocity), len(state.effort)]
    fields = [f"{stamp.sec}.{stamp.nanosec:09}", state.header.frame_id, *state.name, *state.position, "|", *numbers]
    assert " ".join(map(str, fields)) == PEER_STATE


def test_stopped_reliable_peer_does_not_block_the_publisher(
    peer: Path, graph: backend.Graph, domain: int, schema: Schema, topic: str
) -> None:
    type_name_ = "std_msgs/ByteMultiArray"
    sent, back = (wire(schema, f"{topic}/{name}", type_name_, sample_size=100_000) for name in ("there", "back"))
    received: Queue[Any] = Queue()
    graph.subscribe(back, received.put, Errors())
    outlet = graph.publisher(sent)
    message = outlet.new()
    message.data = numpy.zeros(100_000, dtype=numpy.uint8)
    with running(peer, domain, "reliable", "volatile", *task(sent, back)) as program:
        until(lambda: outlet.send(message) or not received.empty())
        program.process.send_signal(signal.SIGSTOP)
        longest = 0.0
        for _ in range(500):
            started_at = time.monotonic()
            outlet.send(message)
            longest = max(longest, time.monotonic() - started_at)
        assert longest < 1  # usually about 0.1 ms each
        program.process.send_signal(signal.SIGCONT)
        while not received.empty():
            received.get()
        until(lambda: outlet.send(message) or not received.empty())
