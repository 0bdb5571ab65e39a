"""The contract that every backend must keep: checks of a connected backend, which raise AssertionError.

`python -m tests.bridge.contract NAME` runs the checks in the backend's own Python, and prints each outcome as a line of
JSON. The checks require only shmgen.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy

from shmgen.bridge.backend import (
    ABORTED,
    CANCELED,
    SUCCEEDED,
    ActionWire,
    Backend,
    NoAnswer,
    Node,
    RosClient,
    ServiceWire,
    Wire,
)
from shmgen.bridge.codec.direct import Transcoder, direct_codec
from shmgen.bridge.common import choice, watchdog
from shmgen.bridge.plan import closure
from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Span
from shmgen.core.model import Schema
from shmgen.generator import pipeline
from shmgen.live.session import Session

LIMIT = 20.0
"""Seconds after which an expected event counts as missing."""
AT_ONCE = 3.0
"""The longest time in seconds for an action that waits for no peer, on a machine with tenfold overload."""
SETBOOL = "bool data # e.g. for hardware enabling / disabling\n---\nbool success\nstring message\n"
FIBONACCI = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"
"""test_msgs/Fibonacci, which the wheels of ROS 2 contain."""
SOURCES = {"ros1": "noetic"}
WITHOUT_MESSAGES = {f"shmgen.bridge.{name}.backend" for name in ("dds", "ros1", "zenoh")}
"""Backends without ROS message classes, which pass bytes to bytes."""


class Scene:
    """A connected backend, and a factory of wires that uses every name once."""

    def __init__(self, backend: Backend, source: str, logged: list[str]) -> None:
        self.backend, self.logged = backend, logged
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "std_srvs", "srv", "SetBool.srv")
            file.parent.mkdir(parents=True)
            file.write_text(SETBOOL)
            file = Path(folder, "test_msgs", "action", "Fibonacci.action")
            file.parent.mkdir(parents=True)
            file.write_text(FIBONACCI)
            types = (
                "test_msgs/Fibonacci",
                "sensor_msgs/JointState",
                "geometry_msgs/PoseArray",
                "std_msgs/String",
                "std_srvs/SetBool",
            )
            self.schema: Schema = pipeline.read(Config(Path(folder), source=source, path=(Path(folder),)), types)
        bounds = Bounds({}, {"sensor_msgs": Bound(4, Span("contract"))})
        self._session = Session(Config(Path.cwd(), source=source, bounds=bounds))
        self._names: Iterator[int] = iter(range(1000))

    def wire(self, type_: str, **options: Any) -> Wire:
        return Wire(f"/contract/t{next(self._names)}", self._messages(type_), **options)

    def kind(self, type_: str) -> type[Any]:
        """Return the Python class of shmgen for the type."""
        return self._session.message(type_)

    def direct_codec_of(self, type_: str) -> Transcoder | None:
        return direct_codec(self.kind(type_), ("header", "stamp"))

    def service(self) -> ServiceWire:
        halves = (self._messages(f"std_srvs/SetBool_{half}") for half in ("Request", "Response"))
        return ServiceWire(f"/contract/s{next(self._names)}", *halves)

    def action(self) -> ActionWire:
        parts = (self._messages(f"test_msgs/Fibonacci_{part}") for part in ("Goal", "Result", "Feedback"))
        goal, result, feedback = parts
        return ActionWire(f"/contract/a{next(self._names)}", goal, result, feedback)

    def _messages(self, type_: str) -> Any:
        name = next(message.name for message in self.schema.messages if message.name.short == type_)
        return closure(self.schema, name)

    def line(self, type_: str = "std_msgs/String", **options: Any) -> Line:
        """Return a topic whose publisher and subscriber have discovered each other."""
        topic = Line(self, self.wire(type_, **options))
        topic.until(lambda: topic.outlet.send(topic.outlet.new()) or topic.messages, pause=0.05)
        topic.settle()
        return topic


class Line:
    """A topic with its publisher and its subscriber in one node. `messages` contains the received messages."""

    def __init__(self, scene: Scene, wire: Wire) -> None:
        self.wire = wire
        self.messages: list[Any] = []
        self.reports: list[Any] = []
        self.inside = 0
        self.most_inside = 0
        self.new = scene.backend.subscribe(wire, self.take, Errors(self.reports)).new
        self.outlet = scene.backend.publisher(wire)

    def take(self, message: Any) -> None:
        self.inside += 1
        self.most_inside = max(self.most_inside, self.inside)
        time.sleep(0.0002)
        self.messages.append(message)
        self.inside -= 1

    def text(self, text: str) -> Any:
        message = self.outlet.new()
        message.data = text
        return message

    def until(self, condition: Callable[[], Any], pause: float = 0.01) -> None:
        until(condition, pause)

    def settle(self) -> None:
        """Wait until the messages sent during discovery have arrived, then clear them."""
        marks = [f"settled {number}" for number in range(2)]
        if self.wire.type.short == "std_msgs/String":
            for mark in marks:
                self.outlet.send(self.text(mark))
            until(lambda: [message for message in self.messages if message.data == marks[-1]])
        else:
            before = -1
            while before != len(self.messages):
                before = len(self.messages)
                time.sleep(0.3)
        self.messages.clear()


class Errors:
    """An ErrorSink that appends all reports to `logged`."""

    def __init__(self, logged: list[Any] | None = None) -> None:
        self.logged = [] if logged is None else logged

    def reject(self, why: str) -> None:
        self.logged.append(why)

    def refuse(self, why: str) -> None:
        self.logged.append(why)

    def set_incompatible_peer(self, reason: str) -> None:
        self.logged += [reason] if reason else []

    def lose(self, count: int) -> None:
        self.logged.append(count)


def until(condition: Callable[[], Any], pause: float = 0.01) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, f"not within {LIMIT} s"
        time.sleep(pause)


# --- topics ------------------------------------------------------------------------------------------------


def new_message_has_every_field(scene: Scene) -> None:
    """Create messages with every field on both sides, and the stamp with ROS's own fields."""
    line = scene.line("sensor_msgs/JointState")
    for message in (line.outlet.new(), line.new()):
        assert (message.header.frame_id, list(message.name), list(message.position)) == ("", [], [])
        stamp = message.header.stamp
        assert (getattr(stamp, "sec", None), getattr(stamp, "secs", None)) in ((0, None), (None, 0), (0, 0))
        assert line.outlet.new() is not line.outlet.new()


def messages_arrive_in_order(scene: Scene) -> None:
    line = scene.line("sensor_msgs/JointState")
    kind = scene.kind("sensor_msgs/JointState")
    for number in range(200):
        sample = kind(name=["a", "\xe4\u2603"], position=[number + 0.5, -1.0], effort=[])
        sample.header.frame_id = f"frame {number}"
        message = line.outlet.new()
        kind._decode(bytes(sample), message)  # the bridge fills messages the same way
        line.outlet.send(message)
    until(lambda: len(line.messages) >= 200)
    received = [(msg.header.frame_id, list(msg.name), list(msg.position), list(msg.effort)) for msg in line.messages]
    assert received == [(f"frame {number}", ["a", "\xe4\u2603"], [number + 0.5, -1.0], []) for number in range(200)]
    assert not line.reports


def direct_codec_delivers_equal_messages(scene: Scene) -> None:
    """Deliver an ordinary payload as shmgen's own class, other payloads as messages, in order and stamped."""
    name = "sensor_msgs/JointState"
    kind = scene.kind(name)
    line = scene.line(name, direct=scene.direct_codec_of(name))
    if type(scene.backend).__module__ not in WITHOUT_MESSAGES:
        assert not line.outlet.send_sample(kind())
        return
    names = ["plain", "\xe4\u2603"]
    for name in names:
        line.outlet.send_sample(kind(name=[name], position=[1.5]))
    until(lambda: len(line.messages) >= 2)
    assert [(list(msg.name), list(msg.position)) for msg in line.messages] == [([name], [1.5]) for name in names]
    assert type(line.messages[0]) is kind, "an ordinary message uses the direct codec"
    for message in line.messages:
        seconds = getattr(message.header.stamp, "secs", None) or message.header.stamp.sec
        assert abs(time.time() - seconds) < LIMIT


def lists_accept_objects_of_any_class(scene: Scene) -> None:
    line = scene.line("geometry_msgs/PoseArray")
    message = line.outlet.new()
    position, orientation = SimpleNamespace(x=1.0, y=2.0, z=3.0), SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    message.poses = [SimpleNamespace(position=position, orientation=orientation)] * 2
    line.outlet.send(message)
    until(lambda: line.messages)
    assert [(pose.position.y, pose.orientation.w) for pose in line.messages[0].poses] == [(2.0, 1.0)] * 2


def message_is_copied_when_sent(scene: Scene) -> None:
    line = scene.line()
    message = line.text("first")
    line.outlet.send(message)
    message.data = "second"
    line.outlet.send(message)
    until(lambda: len(line.messages) >= 2)
    assert [message.data for message in line.messages] == ["first", "second"]


def far_too_long_message_is_rejected(scene: Scene) -> None:
    """Reject it in the receiver, or already in the sender as Cyclone does. Pass the next message."""
    line = scene.line()
    try:
        line.outlet.send(line.text("x" * (line.wire.largest + 1)))
    except Exception as error:
        line.reports.append(error)
    line.outlet.send(line.text("next"))
    until(lambda: line.messages and line.reports)
    assert [message.data for message in line.messages] == ["next"]


def messages_are_delivered_one_at_a_time(scene: Scene) -> None:
    """Deliver one message at a time, even if several threads send."""
    line = scene.line()
    threads = [
        threading.Thread(target=lambda: [line.outlet.send(line.text("x")) for _ in range(50)], daemon=True)
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    until(lambda: len(line.messages) >= 200)
    assert line.most_inside == 1


def sending_needs_no_subscriber(scene: Scene) -> None:
    outlet = scene.backend.publisher(scene.wire("std_msgs/String"))
    started_at = time.monotonic()
    for _ in range(100):
        outlet.send(outlet.new())
    assert time.monotonic() - started_at < AT_ONCE


def latched_message_reaches_late_subscriber(scene: Scene) -> None:
    """Deliver the newest latched message, and no message of a topic without latch."""
    wires = [scene.wire("std_msgs/String", latch=latch) for latch in (True, False)]
    outlets = [scene.backend.publisher(wire) for wire in wires]
    for outlet in outlets:
        for text in ("old", "new"):
            message = outlet.new()
            message.data = text
            outlet.send(message)
    time.sleep(0.3)
    subscribers = [_SubscriberOnly(scene, wire) for wire in wires]
    until(lambda: subscribers[0].messages)
    time.sleep(0.5)
    assert [[message.data for message in line.messages] for line in subscribers] == [["new"], []]


class _SubscriberOnly(Line):
    """A topic with only a subscriber."""

    def __init__(self, scene: Scene, wire: Wire) -> None:
        self.messages, self.reports, self.inside, self.most_inside = [], [], 0, 0
        scene.backend.subscribe(wire, self.take, Errors(self.reports))


# --- services ----------------------------------------------------------------------------------------------


def call_is_answered(scene: Scene) -> None:
    caller = _serve_and_call(scene, _answer_call)
    for data in (True, False, True):
        response = _call(caller, data)
        assert (response.success, response.message) == (data, f"asked {data}")


def slow_call_does_not_block_topics(scene: Scene) -> None:
    """Deliver messages of a topic while a call waits for its reply."""

    request_received, go = threading.Event(), threading.Event()

    def slow(request: Any, response: Any) -> None:
        if request.data:
            request_received.set()
            go.wait(LIMIT)
        _answer_call(request, response)

    line, caller = scene.line(), _serve_and_call(scene, slow)
    received: list[Any] = []
    thread = threading.Thread(target=lambda: received.append(_call(caller, True)), daemon=True)
    thread.start()
    until(request_received.is_set)
    line.outlet.send(line.text("meanwhile"))
    until(lambda: line.messages)
    assert not received
    go.set()
    thread.join(LIMIT)
    assert received[0].success


def call_without_server_raises_no_answer(scene: Scene) -> None:
    caller = scene.backend.client(scene.service())
    _check_no_answer(caller, 0.3)


def failed_call_raises_no_answer(scene: Scene) -> None:
    """Raise NoAnswer at the latest at the timeout, because not every ROS can report a failed call."""

    def fail(request: Any, response: Any) -> None:
        if request.data:
            raise NoAnswer("the PLC is off")
        _answer_call(request, response)

    caller = _serve_and_call(scene, fail)
    _check_no_answer(caller, 0.5)
    assert _call(caller, False).message == "asked False"


def late_reply_raises_no_answer(scene: Scene) -> None:
    def slow(request: Any, response: Any) -> None:
        time.sleep(AT_ONCE if request.data else 0.0)
        _answer_call(request, response)

    caller = _serve_and_call(scene, slow)
    _check_no_answer(caller, 0.2)
    until(lambda: _is_answered(caller))


def _answer_call(request: Any, response: Any) -> None:
    response.success, response.message = bool(request.data), f"asked {bool(request.data)}"


def _serve_and_call(scene: Scene, answer: Callable[[Any, Any], None], wire: ServiceWire | None = None) -> RosClient:
    """Serve the service, and return a client whose first call has been answered."""
    wire = wire or scene.service()
    scene.backend.serve(wire, answer, Errors(scene.logged))
    caller = scene.backend.client(wire)
    until(lambda: _is_answered(caller))
    return caller


def _is_answered(caller: RosClient) -> bool:
    try:
        return not _call(caller, False, LIMIT / 4).success
    except NoAnswer:
        return False


def _call(caller: RosClient, data: bool, timeout: float = 20.0) -> Any:
    request = caller.new()
    request.data = data
    return caller.call(request, timeout)


def _check_no_answer(caller: RosClient, timeout: float) -> None:
    request = caller.new()
    request.data = True
    started_at = time.monotonic()
    try:
        caller.call(request, timeout)
    except NoAnswer as error:
        reason = str(error)
    else:
        raise AssertionError("the call had a reply")
    assert reason, "NoAnswer has no reason"
    assert time.monotonic() - started_at < timeout + AT_ONCE


# --- actions -----------------------------------------------------------------------------------------------


class Work:
    """A Worker, which records `goals` and `canceled`, and the Follower of one goal, which records the rest."""

    def __init__(self, scene: Scene, accepts: bool = True) -> None:
        self.accepts = accepts
        self.goals: list[Any] = []
        self.canceled: list[Any] = []
        self.feedbacks: list[list[int]] = []
        self.ends: list[tuple[int, Any, str]] = []
        wire = scene.action()
        logged = Errors(scene.logged)
        scene.backend.actions.serve(scene.backend, wire, self, logged)
        self.action_client = scene.backend.actions.action_client(scene.backend, wire, logged)

    def begin(self, goal: Any) -> bool:
        self.goals.append(goal)
        return self.accepts

    def cancel(self, goal: Any) -> bool:
        self.canceled.append(goal)
        return True

    def feedback(self, feedback: Any) -> None:
        self.feedbacks.append(list(feedback.sequence))

    def end(self, status: int, result: Any, why: str = "") -> None:
        self.ends.append((status, result and list(result.sequence), why))

    def send_goal(self, order: int) -> Any:
        return self.action_client.send(lambda goal: setattr(goal, "order", order), LIMIT, self)


def _sequence(*numbers: int) -> Callable[[Any], None]:
    return lambda message: setattr(message, "sequence", numpy.array(numbers, "int32"))


def goal_has_feedback_and_one_result(scene: Scene) -> None:
    """Ignore a second result of the goal."""
    work = Work(scene)
    for status in (SUCCEEDED, ABORTED, CANCELED):
        assert work.send_goal(7), "the goal was rejected"
        goal = work.goals[-1]
        assert goal.request.order == 7
        until(lambda goal=goal: goal.progress(_sequence(1, 2)) or work.feedbacks, pause=0.05)
        goal.end(status, _sequence(3))
        goal.end(SUCCEEDED, _sequence(4))
        until(lambda: work.ends)
        assert (work.ends, work.feedbacks[-1]) == ([(status, [3], "")], [1, 2])
        work.ends.clear()
        work.feedbacks.clear()


def rejected_goal_returns_none(scene: Scene) -> None:
    work = Work(scene, accepts=False)
    assert work.send_goal(1) is None
    time.sleep(0.3)
    assert not work.ends


def cancel_reaches_its_goal(scene: Scene) -> None:
    work = Work(scene)
    cancels = [work.send_goal(number) for number in (1, 2)]
    cancels[0]()
    until(lambda: work.canceled)
    assert work.canceled == [work.goals[0]]
    for goal in work.goals:
        goal.end(CANCELED, _sequence())
    until(lambda: len(work.ends) >= 2)


def goal_without_server_raises_no_answer(scene: Scene) -> None:
    """Raise NoAnswer soon after the timeout."""
    action_client = scene.backend.actions.action_client(scene.backend, scene.action(), Errors(scene.logged))
    started_at = time.monotonic()
    try:
        action_client.send(lambda goal: None, 0.5, None)  # type: ignore[arg-type]
    except NoAnswer as error:
        reason = str(error)
    else:
        raise AssertionError("the goal was accepted")
    assert reason, "NoAnswer has no reason"
    assert time.monotonic() - started_at < 0.5 + AT_ONCE


# --- the node ----------------------------------------------------------------------------------------------


def undo_removes_only_its_own_endpoints(scene: Scene) -> None:
    """Remove endpoints and create them again, as two reloads of shmgen.toml do."""
    other, wire = scene.line(), scene.wire("std_msgs/String")
    for _ in range(2):
        scene.backend.undo = []
        line = Line(scene, wire)
        line.until(lambda line=line: line.outlet.send(line.outlet.new()) or line.messages, pause=0.05)
        line.settle()
        service = scene.service()
        _serve_and_call(scene, _answer_call, service)
        assert len(scene.backend.undo) >= 2
        for undo in reversed(scene.backend.undo):
            undo()
        count_before = len(line.messages)
        second_outlet = scene.backend.publisher(wire)
        other.messages.clear()
        for _ in range(5):
            second_outlet.send(second_outlet.new())
            other.outlet.send(other.text("on"))
        other.until(lambda: len(other.messages) == 5)
        assert len(line.messages) == count_before
        _check_no_answer(scene.backend.client(service), 0.2)


def undo_leaves_no_threads_or_descriptors(scene: Scene) -> None:
    """Release threads and descriptors, because a bridge may reload shmgen.toml for years."""

    def create_and_undo() -> None:
        scene.backend.undo = []
        scene.line()
        _serve_and_call(scene, _answer_call)
        for undo in reversed(scene.backend.undo):
            undo()

    def resources() -> dict[str, int]:
        gc.collect()
        return {kind: len(os.listdir(f"/proc/self/{kind}")) for kind in ("task", "fd")}

    for _ in range(2):  # the first endpoints create resources that all later ones share
        create_and_undo()
    before = resources()
    for _ in range(4):
        create_and_undo()
    until(lambda: all(count <= before[kind] for kind, count in resources().items()))


def backend_is_alive_and_has_the_time(scene: Scene) -> None:
    assert scene.backend.alive()
    now = scene.backend.now()
    assert abs(now.sec + now.nanosec / 1e9 - time.time()) < 5


def close_is_prompt_and_final(scene: Scene) -> None:
    """Close during a call, and deliver no message afterwards. This check must be the last."""
    line = scene.line()
    caller = _serve_and_call(scene, lambda request, response: time.sleep(1.0 if request.data else 0.0))
    threading.Thread(target=lambda: _ignore_errors(lambda: _call(caller, True)), daemon=True).start()
    time.sleep(0.2)
    started_at = time.monotonic()
    scene.backend.close()
    assert time.monotonic() - started_at < AT_ONCE
    line.messages.clear()
    _ignore_errors(lambda: line.outlet.send(line.text("after the end")))
    time.sleep(0.3)
    assert not line.messages


def _ignore_errors(call: Callable[[], Any]) -> None:
    try:
        call()
    except Exception:
        return


CHECKS: tuple[Callable[[Scene], None], ...] = (
    new_message_has_every_field,
    messages_arrive_in_order,
    direct_codec_delivers_equal_messages,
    lists_accept_objects_of_any_class,
    message_is_copied_when_sent,
    far_too_long_message_is_rejected,
    messages_are_delivered_one_at_a_time,
    sending_needs_no_subscriber,
    latched_message_reaches_late_subscriber,
    call_is_answered,
    slow_call_does_not_block_topics,
    call_without_server_raises_no_answer,
    failed_call_raises_no_answer,
    late_reply_raises_no_answer,
    goal_has_feedback_and_one_result,
    rejected_goal_returns_none,
    cancel_reaches_its_goal,
    goal_without_server_raises_no_answer,
    undo_removes_only_its_own_endpoints,
    undo_leaves_no_threads_or_descriptors,
    backend_is_alive_and_has_the_time,
    close_is_prompt_and_final,
)


def main(name: str) -> None:
    logged: list[str] = []
    module = choice.module(name)
    backend = module.connect(Node("shmgen_contract", None, logged.append, lambda: False))
    assert backend is not None, "the backend found no graph"
    scene = Scene(backend, SOURCES.get(name, "jazzy"), logged)
    for check in CHECKS:
        try:
            check(scene)
            failed = ""
        except Exception:
            failed = traceback.format_exc() + "".join(f"logged: {line}\n" for line in logged)
        print(json.dumps({"check": check.__name__, "failed": failed}), flush=True)
    watchdog.exit_at_once()  # the bridge also exits this way: a call is still running


if __name__ == "__main__":
    main(sys.argv[1])
