"""What every backend must keep: checks of one that has joined its graph, which raise AssertionError.

`python -m tests.bridge.contract NAME` runs them in a process of the backend's own Python, and prints what came of each
as a line of JSON. It needs nothing that is not in shmgen.
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
"""Seconds after which what should have come has not."""
AT_ONCE = 3.0
"""Seconds that anything takes at most which waits for nobody, on a machine with ten times more to do than it can."""
SETBOOL = "bool data # e.g. for hardware enabling / disabling\n---\nbool success\nstring message\n"
FIBONACCI = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"
"""test_msgs/Fibonacci, which the wheels of ROS 2 have."""
SOURCES = {"ros1": "noetic"}
WITHOUT_MESSAGES = {f"shmgen.bridge.{name}.backend" for name in ("dds", "ros1", "zenoh")}
"""Backends that carry bytes to bytes."""


class Scene:
    """A backend in its graph, and the wires of a definition; every name is used once."""

    def __init__(self, backend: Backend, source: str, told: list[str]) -> None:
        self.backend, self.told = backend, told
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

    def wire(self, type_: str, **how: Any) -> Wire:
        return Wire(f"/contract/t{next(self._names)}", self._messages(type_), **how)

    def kind(self, type_: str) -> type[Any]:
        """The class that has its bytes."""
        return self._session.message(type_)

    def short(self, type_: str) -> Transcoder | None:
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

    def line(self, type_: str = "std_msgs/String", **how: Any) -> Line:
        """A topic whose both ends know of each other."""
        made = Line(self, self.wire(type_, **how))
        made.until(lambda: made.outlet.send(made.outlet.new()) or made.taken, pause=0.05)
        made.settle()
        return made


class Line:
    """A topic with both its ends in one node; what comes is in `taken`."""

    def __init__(self, scene: Scene, wire: Wire) -> None:
        self.wire = wire
        self.taken: list[Any] = []
        self.others: list[Any] = []
        self.inside = 0
        self.most_inside = 0
        self.new = scene.backend.subscribe(wire, self).new
        self.outlet = scene.backend.publisher(wire)

    def take(self, message: Any) -> None:
        self.inside += 1
        self.most_inside = max(self.most_inside, self.inside)
        time.sleep(0.0002)
        self.taken.append(message)
        self.inside -= 1

    def reject(self, why: str) -> None:
        self.others.append(why)

    def refuse(self, why: str) -> None:
        self.others.append(why)

    def set_incompatible_peer(self, reason: str) -> None:
        self.others += [reason] if reason else []

    def lose(self, count: int) -> None:
        self.others.append(count)

    def text(self, text: str) -> Any:
        message = self.outlet.new()
        message.data = text
        return message

    def until(self, true: Callable[[], Any], pause: float = 0.01) -> None:
        until(true, pause)

    def settle(self) -> None:
        """What was sent to find out whether anybody listens is over."""
        marks = [f"settled {number}" for number in range(2)]
        if self.wire.type.short == "std_msgs/String":
            for mark in marks:
                self.outlet.send(self.text(mark))
            until(lambda: [one for one in self.taken if one.data == marks[-1]])
        else:
            before = -1
            while before != len(self.taken):
                before = len(self.taken)
                time.sleep(0.3)
        self.taken.clear()


def until(true: Callable[[], Any], pause: float = 0.01) -> None:
    deadline = time.monotonic() + LIMIT
    while not true():
        assert time.monotonic() < deadline, f"not within {LIMIT} s"
        time.sleep(pause)


# --- topics ------------------------------------------------------------------------------------------------


def an_empty_message_has_every_field(scene: Scene) -> None:
    """On both sides, down to the last; a clock is what ROS has for it."""
    line = scene.line("sensor_msgs/JointState")
    for message in (line.outlet.new(), line.new()):
        assert (message.header.frame_id, list(message.name), list(message.position)) == ("", [], [])
        stamp = message.header.stamp
        assert (getattr(stamp, "sec", None), getattr(stamp, "secs", None)) in ((0, None), (None, 0), (0, 0))
        assert line.outlet.new() is not line.outlet.new()


def what_is_sent_arrives_in_order(scene: Scene) -> None:
    line = scene.line("sensor_msgs/JointState")
    kind = scene.kind("sensor_msgs/JointState")
    for number in range(200):
        sample = kind(name=["a", "\xe4\u2603"], position=[number + 0.5, -1.0], effort=[])
        sample.header.frame_id = f"frame {number}"
        message = line.outlet.new()
        kind._decode(bytes(sample), message)  # as the bridge fills one
        line.outlet.send(message)
    until(lambda: len(line.taken) >= 200)
    got = [(one.header.frame_id, list(one.name), list(one.position), list(one.effort)) for one in line.taken]
    assert got == [(f"frame {number}", ["a", "\xe4\u2603"], [number + 0.5, -1.0], []) for number in range(200)]
    assert not line.others


def the_short_way_leads_to_the_same(scene: Scene) -> None:
    """What a region holds arrives as that itself where it is ordinary, else as a message; in order, with a stamp."""
    name = "sensor_msgs/JointState"
    kind = scene.kind(name)
    line = scene.line(name, direct=scene.short(name))
    if type(scene.backend).__module__ not in WITHOUT_MESSAGES:
        assert line.outlet.send_payload is None
        return
    names = ["plain", "\xe4\u2603"]
    for name in names:
        line.outlet.send_payload(bytes(kind(name=[name], position=[1.5])))
    until(lambda: len(line.taken) >= 2)
    assert [(list(one.name), list(one.position)) for one in line.taken] == [([name], [1.5]) for name in names]
    assert type(line.taken[0]) is kind, "an ordinary message takes the short way"
    for one in line.taken:
        seconds = getattr(one.header.stamp, "secs", None) or one.header.stamp.sec
        assert abs(time.time() - seconds) < LIMIT


def lists_may_hold_objects_of_any_class(scene: Scene) -> None:
    line = scene.line("geometry_msgs/PoseArray")
    message = line.outlet.new()
    place, turn = SimpleNamespace(x=1.0, y=2.0, z=3.0), SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    message.poses = [SimpleNamespace(position=place, orientation=turn)] * 2
    line.outlet.send(message)
    until(lambda: line.taken)
    assert [(pose.position.y, pose.orientation.w) for pose in line.taken[0].poses] == [(2.0, 1.0)] * 2


def a_message_is_as_it_was_when_it_was_sent(scene: Scene) -> None:
    line = scene.line()
    message = line.text("first")
    line.outlet.send(message)
    message.data = "second"
    line.outlet.send(message)
    until(lambda: len(line.taken) >= 2)
    assert [one.data for one in line.taken] == ["first", "second"]


def a_message_that_is_far_too_long_is_rejected(scene: Scene) -> None:
    """By the receiver, or already by the sender as in Cyclone; the next one passes."""
    line = scene.line()
    try:
        line.outlet.send(line.text("x" * (line.wire.largest + 1)))
    except Exception as error:
        line.others.append(error)
    line.outlet.send(line.text("next"))
    until(lambda: line.taken and line.others)
    assert [one.data for one in line.taken] == ["next"]


def one_at_a_time_is_handed_over(scene: Scene) -> None:
    """Whoever sends, from however many threads."""
    line = scene.line()
    threads = [
        threading.Thread(target=lambda: [line.outlet.send(line.text("x")) for _ in range(50)], daemon=True)
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    until(lambda: len(line.taken) >= 200)
    assert line.most_inside == 1


def nobody_has_to_listen(scene: Scene) -> None:
    outlet = scene.backend.publisher(scene.wire("std_msgs/String"))
    begun = time.monotonic()
    for _ in range(100):
        outlet.send(outlet.new())
    assert time.monotonic() - begun < AT_ONCE


def what_is_latched_reaches_who_comes_late(scene: Scene) -> None:
    """The newest; and what is not latched does not."""
    wires = [scene.wire("std_msgs/String", latch=latch) for latch in (True, False)]
    outlets = [scene.backend.publisher(wire) for wire in wires]
    for outlet in outlets:
        for text in ("old", "new"):
            message = outlet.new()
            message.data = text
            outlet.send(message)
    time.sleep(0.3)
    late = [_Late(scene, wire) for wire in wires]
    until(lambda: late[0].taken)
    time.sleep(0.5)
    assert [[one.data for one in line.taken] for line in late] == [["new"], []]


class _Late(Line):
    """A subscriber alone."""

    def __init__(self, scene: Scene, wire: Wire) -> None:
        self.taken, self.others, self.inside, self.most_inside = [], [], 0, 0
        scene.backend.subscribe(wire, self)


# --- services ----------------------------------------------------------------------------------------------


def a_call_is_answered(scene: Scene) -> None:
    caller = _served(scene, _say_so)
    for data in (True, False, True):
        response = _asked(caller, data)
        assert (response.success, response.message) == (data, f"asked {data}")


def an_answer_may_take_its_time(scene: Scene) -> None:
    """And topics go on meanwhile."""

    asked, go = threading.Event(), threading.Event()

    def slow(request: Any, response: Any) -> None:
        if request.data:
            asked.set()
            go.wait(LIMIT)
        _say_so(request, response)

    line, caller = scene.line(), _served(scene, slow)
    got: list[Any] = []
    thread = threading.Thread(target=lambda: got.append(_asked(caller, True)), daemon=True)
    thread.start()
    until(asked.is_set)
    line.outlet.send(line.text("meanwhile"))
    until(lambda: line.taken)
    assert not got
    go.set()
    thread.join(LIMIT)
    assert got[0].success


def nobody_there_is_no_answer(scene: Scene) -> None:
    caller = scene.backend.client(scene.service())
    _no_answer(caller, 0.3)


def an_answer_that_fails_is_no_answer(scene: Scene) -> None:
    """A ROS that cannot say so lets the client wait."""

    def fail(request: Any, response: Any) -> None:
        if request.data:
            raise NoAnswer("the PLC is off")
        _say_so(request, response)

    caller = _served(scene, fail)
    _no_answer(caller, 0.5)
    assert _asked(caller, False).message == "asked False"


def an_answer_too_late_is_no_answer(scene: Scene) -> None:
    def slow(request: Any, response: Any) -> None:
        time.sleep(AT_ONCE if request.data else 0.0)
        _say_so(request, response)

    caller = _served(scene, slow)
    _no_answer(caller, 0.2)
    until(lambda: _tried(caller))


def _say_so(request: Any, response: Any) -> None:
    response.success, response.message = bool(request.data), f"asked {bool(request.data)}"


def _served(scene: Scene, answer: Callable[[Any, Any], None], wire: ServiceWire | None = None) -> RosClient:
    """A caller of a service that is there: the first call is answered."""
    wire = wire or scene.service()
    scene.backend.serve(wire, answer, scene.told.append)
    caller = scene.backend.client(wire)
    until(lambda: _tried(caller))
    return caller


def _tried(caller: RosClient) -> bool:
    try:
        return not _asked(caller, False, LIMIT / 4).success
    except NoAnswer:
        return False


def _asked(caller: RosClient, data: bool, timeout: float = 20.0) -> Any:
    request = caller.new()
    request.data = data
    return caller.call(request, timeout)


def _no_answer(caller: RosClient, timeout: float) -> None:
    request = caller.new()
    request.data = True
    begun = time.monotonic()
    try:
        caller.call(request, timeout)
    except NoAnswer as error:
        why = str(error)
    else:
        raise AssertionError("there was an answer")
    assert why, "it says why"
    assert time.monotonic() - begun < timeout + AT_ONCE


# --- actions -----------------------------------------------------------------------------------------------


class Work:
    """A Worker, to whom `begun` and `canceled` came, and the Follower of one goal, to whom came the rest."""

    def __init__(self, scene: Scene, accepts: bool = True) -> None:
        self.accepts = accepts
        self.begun: list[Any] = []
        self.canceled: list[Any] = []
        self.heard: list[list[int]] = []
        self.ends: list[tuple[int, Any, str]] = []
        wire = scene.action()
        told = _ErrorSink(scene.told)
        scene.backend.actions.serve(scene.backend, wire, self, told)
        self.action_client = scene.backend.actions.action_client(scene.backend, wire, told)

    def begin(self, goal: Any) -> bool:
        self.begun.append(goal)
        return self.accepts

    def cancel(self, goal: Any) -> bool:
        self.canceled.append(goal)
        return True

    def feedback(self, feedback: Any) -> None:
        self.heard.append(list(feedback.sequence))

    def end(self, status: int, result: Any, why: str = "") -> None:
        self.ends.append((status, result and list(result.sequence), why))

    def seek(self, order: int) -> Any:
        return self.action_client.send(lambda goal: setattr(goal, "order", order), LIMIT, self)


class _ErrorSink:
    def __init__(self, told: list[str]) -> None:
        self.reject = self.refuse = self.set_incompatible_peer = told.append

    def lose(self, count: int) -> None:
        """Of no matter here."""


def _sequence(*numbers: int) -> Callable[[Any], None]:
    return lambda message: setattr(message, "sequence", numpy.array(numbers, "int32"))


def a_goal_has_feedback_and_one_end(scene: Scene) -> None:
    """Whatever comes behind the end goes nowhere."""
    work = Work(scene)
    for status in (SUCCEEDED, ABORTED, CANCELED):
        assert work.seek(7), "it was accepted"
        goal = work.begun[-1]
        assert goal.request.order == 7
        until(lambda goal=goal: goal.progress(_sequence(1, 2)) or work.heard, pause=0.05)
        goal.end(status, _sequence(3))
        goal.end(SUCCEEDED, _sequence(4))
        until(lambda: work.ends)
        assert (work.ends, work.heard[-1]) == ([(status, [3], "")], [1, 2])
        work.ends.clear()
        work.heard.clear()


def a_goal_that_is_not_accepted_is_none(scene: Scene) -> None:
    work = Work(scene, accepts=False)
    assert work.seek(1) is None
    time.sleep(0.3)
    assert not work.ends


def a_cancel_reaches_its_goal(scene: Scene) -> None:
    work = Work(scene)
    cancels = [work.seek(number) for number in (1, 2)]
    cancels[0]()
    until(lambda: work.canceled)
    assert work.canceled == [work.begun[0]]
    for goal in work.begun:
        goal.end(CANCELED, _sequence())
    until(lambda: len(work.ends) >= 2)


def a_goal_that_nobody_takes_is_no_answer(scene: Scene) -> None:
    """And says so within its time."""
    seeker = scene.backend.actions.action_client(scene.backend, scene.action(), _ErrorSink(scene.told))
    begun = time.monotonic()
    try:
        seeker.send(lambda goal: None, 0.5, None)  # type: ignore[arg-type]
    except NoAnswer as error:
        why = str(error)
    else:
        raise AssertionError("somebody has taken it")
    assert why, "it says why"
    assert time.monotonic() - begun < 0.5 + AT_ONCE


# --- the node ----------------------------------------------------------------------------------------------


def what_is_undone_is_gone_and_the_rest_goes_on(scene: Scene) -> None:
    """And can be made again, as where shmgen.toml was changed twice."""
    other, wire = scene.line(), scene.wire("std_msgs/String")
    for _ in range(2):
        scene.backend.undo = []
        line = Line(scene, wire)
        line.until(lambda line=line: line.outlet.send(line.outlet.new()) or line.taken, pause=0.05)
        line.settle()
        service = scene.service()
        _served(scene, _say_so, service)
        assert len(scene.backend.undo) >= 2
        for undo in reversed(scene.backend.undo):
            undo()
        came = len(line.taken)
        again = scene.backend.publisher(wire)
        other.taken.clear()
        for _ in range(5):
            again.send(again.new())
            other.outlet.send(other.text("on"))
        other.until(lambda: len(other.taken) == 5)
        assert len(line.taken) == came
        _no_answer(scene.backend.client(service), 0.2)


def what_is_undone_leaves_nothing_behind(scene: Scene) -> None:
    """Neither threads nor descriptors; a bridge may be told of a changed shmgen.toml for years."""

    def made_and_undone() -> None:
        scene.backend.undo = []
        scene.line()
        _served(scene, _say_so)
        for undo in reversed(scene.backend.undo):
            undo()

    def held() -> dict[str, int]:
        gc.collect()
        return {kind: len(os.listdir(f"/proc/self/{kind}")) for kind in ("task", "fd")}

    for _ in range(2):  # some of what the first need stays for all
        made_and_undone()
    before = held()
    for _ in range(4):
        made_and_undone()
    until(lambda: all(count <= before[kind] for kind, count in held().items()))


def it_is_alive_and_knows_the_time(scene: Scene) -> None:
    assert scene.backend.alive()
    now = scene.backend.now()
    assert abs(now.sec + now.nanosec / 1e9 - time.time()) < 5


def it_leaves_at_once_and_for_good(scene: Scene) -> None:
    """With a call on its way; nothing is handed over from then on. The last of all checks."""
    line = scene.line()
    caller = _served(scene, lambda request, response: time.sleep(1.0 if request.data else 0.0))
    threading.Thread(target=lambda: _quietly(lambda: _asked(caller, True)), daemon=True).start()
    time.sleep(0.2)
    begun = time.monotonic()
    scene.backend.close()
    assert time.monotonic() - begun < AT_ONCE
    line.taken.clear()
    _quietly(lambda: line.outlet.send(line.text("after the end")))
    time.sleep(0.3)
    assert not line.taken


def _quietly(call: Callable[[], Any]) -> None:
    try:
        call()
    except Exception:
        return


CHECKS: tuple[Callable[[Scene], None], ...] = (
    an_empty_message_has_every_field,
    what_is_sent_arrives_in_order,
    the_short_way_leads_to_the_same,
    lists_may_hold_objects_of_any_class,
    a_message_is_as_it_was_when_it_was_sent,
    a_message_that_is_far_too_long_is_rejected,
    one_at_a_time_is_handed_over,
    nobody_has_to_listen,
    what_is_latched_reaches_who_comes_late,
    a_call_is_answered,
    an_answer_may_take_its_time,
    nobody_there_is_no_answer,
    an_answer_that_fails_is_no_answer,
    an_answer_too_late_is_no_answer,
    a_goal_has_feedback_and_one_end,
    a_goal_that_is_not_accepted_is_none,
    a_cancel_reaches_its_goal,
    a_goal_that_nobody_takes_is_no_answer,
    what_is_undone_is_gone_and_the_rest_goes_on,
    what_is_undone_leaves_nothing_behind,
    it_is_alive_and_knows_the_time,
    it_leaves_at_once_and_for_good,
)


def main(name: str) -> None:
    told: list[str] = []
    module = choice.module(name)
    backend = module.connect(Node("shmgen_contract", None, told.append, lambda: False))
    assert backend is not None, "there is a graph to join"
    scene = Scene(backend, SOURCES.get(name, "jazzy"), told)
    for check in CHECKS:
        try:
            check(scene)
            failed = ""
        except Exception:
            failed = traceback.format_exc() + "".join(f"told: {line}\n" for line in told)
        print(json.dumps({"check": check.__name__, "failed": failed}), flush=True)
    watchdog.exit_at_once()  # as the bridge does: a call is still running


if __name__ == "__main__":
    main(sys.argv[1])
