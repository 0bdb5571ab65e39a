"""An action as the five topics of ROS 1's actionlib.

Source: actionlib's documentation and its Python (1.14), whose state machines these ends satisfy; actionlib_msgs.
"""

from __future__ import annotations

import itertools
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from shmgen.bridge.backend import (
    ABORTED,
    CANCELED,
    SUCCEEDED,
    ActionWire,
    Backend,
    ErrorSink,
    Fill,
    GoalObserver,
    NoAnswer,
    Wire,
    Worker,
)
from shmgen.core.diagnostics import Span
from shmgen.core.model import Message, TypeName
from shmgen.runtime.messages.values import set_clock

_PENDING, _ACTIVE, _PREEMPTED, _SUCCEEDED, _ABORTED, _REJECTED, _PREEMPTING = range(7)
"""Of actionlib_msgs/GoalStatus."""
_ENDS = {SUCCEEDED: _SUCCEEDED, CANCELED: _PREEMPTED, ABORTED: _ABORTED}
_UNDER_WAY = (_PENDING, _ACTIVE, _PREEMPTING)
_PERIOD = 0.2
"""Seconds between two messages of the topic `status`; actionlib's clients take a goal that is not in it for lost."""
_KEPT = 5.0
"""Seconds that a goal stays in it after its end, as in actionlib."""
_SILENCE = 3.0
"""Seconds without a status, or without the goal in it, after which a server has gone."""
_AGAIN = 0.2
"""Seconds after which a goal that no status shows is sent again: rospy tells nobody who is not yet connected."""
_LOOK = 0.02


class _Taker:
    """A MessageSink that calls one function."""

    def __init__(self, take: Callable[[Any], None], mishaps: ErrorSink) -> None:
        self.take = take
        self.reject, self.refuse, self.meet, self.lose = mishaps.reject, mishaps.refuse, mishaps.meet, mishaps.lose


class _Served:
    """A Goal of a ROS client; `goal_id` is its actionlib_msgs/GoalID."""

    def __init__(self, server: _Server, message: Any) -> None:
        self.request = message.goal
        self.goal_id = message.goal_id
        self.status = _PENDING
        self.ended: float | None = None
        self._server = server

    def progress(self, fill: Fill) -> None:
        self._server.progress(self, fill)

    def end(self, status: int, fill: Fill) -> None:
        self._server.end(self, _ENDS[status], fill)


class _Server:
    """All its methods may be called from any thread."""

    def __init__(self, backend: Backend, wire: ActionWire, worker: Worker, mishaps: ErrorSink) -> None:
        said = _Said(wire)
        self._backend = backend
        self._worker = worker
        self._goals: dict[str, _Served] = {}
        self._lock = threading.Lock()
        self._feedback, self._result = backend.publisher(said.feedback), backend.publisher(said.result)
        self._status = backend.publisher(said.status)
        backend.subscribe(said.cancel, _Taker(self._cancel, mishaps))
        backend.subscribe(said.goal, _Taker(self._goal, mishaps))
        threading.Thread(target=self._repeat, daemon=True).start()

    def progress(self, goal: _Served, fill: Fill) -> None:
        self._send(self._feedback, goal, lambda message: fill(message.feedback))

    def end(self, goal: _Served, status: int, fill: Fill) -> None:
        with self._lock:
            if goal.ended is not None:
                return
            goal.status, goal.ended = status, time.monotonic()
        self._send(self._result, goal, lambda message: fill(message.result))
        self._show()

    def _goal(self, message: Any) -> None:
        message.goal_id.id = message.goal_id.id or uuid.uuid4().hex
        if not message.goal_id.stamp:
            message.goal_id.stamp = set_clock(message.goal_id.stamp, self._backend.now())
        goal = _Served(self, message)
        with self._lock:
            if self._goals.setdefault(goal.goal_id.id, goal) is not goal:
                return
        self._show()
        accepted = self._worker.begin(goal)
        with self._lock:
            if accepted and goal.status == _PENDING:
                goal.status = _ACTIVE
        if not accepted:
            self.end(goal, _REJECTED, lambda empty: None)
        self._show()

    def _cancel(self, wanted: Any) -> None:
        """An id means that goal, a stamp all that are not younger, and neither all there are."""
        with self._lock:
            goals = [goal for goal in self._goals.values() if goal.ended is None]
        for goal in goals:
            everything = not wanted.id and not wanted.stamp
            old = wanted.stamp and goal.goal_id.stamp <= wanted.stamp
            if (everything or old or goal.goal_id.id == wanted.id) and self._worker.cancel(goal):
                with self._lock:
                    if goal.ended is None:
                        goal.status = _PREEMPTING
        self._show()

    def _send(self, outlet: Any, goal: _Served, fill: Fill) -> None:
        message = outlet.new()
        message.header.stamp = set_clock(message.header.stamp, self._backend.now())
        message.status.goal_id, message.status.status = goal.goal_id, goal.status
        fill(message)
        outlet.send(message)

    def _show(self) -> None:
        message = self._status.new()
        message.header.stamp = set_clock(message.header.stamp, self._backend.now())
        with self._lock:
            now = time.monotonic()
            for key in [key for key, goal in self._goals.items() if goal.ended and now - goal.ended > _KEPT]:
                del self._goals[key]
            message.status_list = [
                SimpleNamespace(goal_id=goal.goal_id, status=goal.status, text="") for goal in self._goals.values()
            ]
            self._status.send(message)

    def _repeat(self) -> None:
        with suppress(Exception):  # rospy has ended
            while self._backend.alive():
                self._show()
                time.sleep(_PERIOD)


class _Sent:
    """A goal of ours, and who follows it; `seen` is when a status last had it in it."""

    def __init__(self, follower: GoalObserver) -> None:
        self.follower = follower
        self.status: int | None = None
        self.seen = time.monotonic()


class _Client:
    """A Seeker."""

    def __init__(self, backend: Backend, wire: ActionWire, mishaps: ErrorSink) -> None:
        said = _Said(wire)
        self._backend = backend
        self._numbers = itertools.count(1)
        self._sent: dict[str, _Sent] = {}
        self._lock = threading.Lock()
        self._heard = -_SILENCE
        self._canceling, self._goal = backend.publisher(said.cancel), backend.publisher(said.goal)
        backend.subscribe(said.status, _Taker(self._take_status, mishaps))
        backend.subscribe(said.feedback, _Taker(self._take_feedback, mishaps))
        backend.subscribe(said.result, _Taker(self._take_result, mishaps))

    def send(self, fill: Fill, timeout: float, follower: GoalObserver) -> Callable[[], threading.Thread] | None:
        deadline = time.monotonic() + timeout
        key = f"shmgen-{uuid.uuid4().hex}-{next(self._numbers)}"
        message = self._goal.new()
        message.header.stamp = set_clock(message.header.stamp, self._backend.now())
        message.goal_id.stamp = set_clock(message.goal_id.stamp, self._backend.now())
        message.goal_id.id = key
        fill(message.goal)
        self._await(lambda: time.monotonic() - self._heard < _SILENCE, deadline, f"no server within {timeout:g} s")
        sent = self._sent[key] = _Sent(follower)
        try:
            due = 0.0
            while sent.status is None or sent.status == _PENDING:
                if sent.status is None and time.monotonic() >= due:
                    self._goal.send(message)
                    due = time.monotonic() + _AGAIN
                if time.monotonic() >= deadline:
                    raise NoAnswer(f"no answer within {timeout:g} s; the goal is cancelled")
                time.sleep(_LOOK)
        except BaseException:
            self._sent.pop(key, None)
            self._cancel(key)
            raise
        if sent.status == _REJECTED:
            self._sent.pop(key, None)
            return None
        threading.Thread(target=self._watch, args=(key, sent), daemon=True).start()
        return lambda: self._cancel(key)

    def _await(self, true: Callable[[], bool], deadline: float, why: str) -> None:
        while not true():
            if time.monotonic() >= deadline:
                raise NoAnswer(why)
            time.sleep(_LOOK)

    def _take_status(self, message: Any) -> None:
        self._heard = time.monotonic()
        for status in message.status_list:
            if sent := self._sent.get(status.goal_id.id):
                sent.status, sent.seen = status.status, self._heard

    def _take_feedback(self, message: Any) -> None:
        with self._lock:
            if sent := self._sent.get(message.status.goal_id.id):
                sent.status, sent.seen = message.status.status, time.monotonic()
                sent.follower.feedback(message.feedback)

    def _take_result(self, message: Any) -> None:
        with self._lock:
            if sent := self._sent.pop(message.status.goal_id.id, None):
                sent.status = message.status.status
                ends = {theirs: ours for ours, theirs in _ENDS.items()}
                if sent.status != _REJECTED:
                    sent.follower.end(ends.get(sent.status, ABORTED), message.result)

    def _watch(self, key: str, sent: _Sent) -> None:
        while key in self._sent:
            time.sleep(_LOOK)
            if time.monotonic() - sent.seen >= _SILENCE:
                with self._lock:
                    if self._sent.pop(key, None):
                        why = f"the server has not shown the goal for {_SILENCE:g} s"
                        sent.follower.end(ABORTED, None, why)

    def _cancel(self, key: str) -> threading.Thread:
        def run() -> None:
            message = self._canceling.new()
            message.id = key
            self._canceling.send(message)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        return thread


class _Said:
    """The wires of an action. ROS 1 reads the texts alone; its names have no underscore."""

    def __init__(self, wire: ActionWire) -> None:
        name = wire.type.name

        def topic(part: str, messages: tuple[Message, ...], head: str) -> Wire:
            *held, own = messages
            inner = replace(own, name=TypeName(wire.type.package, "msg", f"{name}{part}"))
            text = f"Header header\n{head}\n{name}{part} {part.lower()}\n"
            whole = _message(TypeName(wire.type.package, "msg", f"{name}Action{part}"), text)
            parts = {message.name: message for message in (*held, _HEADER, _GOAL_ID, _STATUS, inner)}
            return Wire(f"{wire.action}/{part.lower()}", (*parts.values(), whole), room=wire.room)

        self.goal = topic("Goal", wire.goal, "actionlib_msgs/GoalID goal_id")
        self.feedback = topic("Feedback", wire.feedback, "actionlib_msgs/GoalStatus status")
        self.result = topic("Result", wire.result, "actionlib_msgs/GoalStatus status")
        self.cancel = Wire(f"{wire.action}/cancel", (_GOAL_ID,))
        self.status = Wire(f"{wire.action}/status", (_HEADER, _GOAL_ID, _STATUS, _STATUSES), latch=True)


def _message(name: TypeName, text: str) -> Message:
    return Message(name, (), (), Span(str(name)), "actionlib_msgs", text)


_HEADER = _message(TypeName("std_msgs", "msg", "Header"), "uint32 seq\ntime stamp\nstring frame_id\n")
_GOAL_ID = _message(TypeName("actionlib_msgs", "msg", "GoalID"), "time stamp\nstring id\n")
_STATUS = _message(
    TypeName("actionlib_msgs", "msg", "GoalStatus"),
    "GoalID goal_id\nuint8 status\nuint8 PENDING=0\nuint8 ACTIVE=1\nuint8 PREEMPTED=2\nuint8 SUCCEEDED=3\n"
    "uint8 ABORTED=4\nuint8 REJECTED=5\nuint8 PREEMPTING=6\nuint8 RECALLING=7\nuint8 RECALLED=8\nuint8 LOST=9\n"
    "string text\n",
)
"""Constants count in ROS 1's md5 sums."""
_STATUSES = _message(TypeName("actionlib_msgs", "msg", "GoalStatusArray"), "Header header\nGoalStatus[] status_list\n")

serve, seeker = _Server, _Client
"""As Actions says it."""
