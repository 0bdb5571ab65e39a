"""Actions of ROS 1: each consists of the five topics of actionlib.

Source: actionlib_msgs, and the documentation and the Python code of actionlib 1.14, whose state machines apply here.
"""

from __future__ import annotations

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
from shmgen.bridge.common.support import await_server
from shmgen.core.diagnostics import Span
from shmgen.core.model import Message, TypeName
from shmgen.runtime.messages.times import set_clock

_PENDING, _ACTIVE, _PREEMPTED, _SUCCEEDED, _ABORTED, _REJECTED, _PREEMPTING = range(7)
"""Status numbers of actionlib_msgs/GoalStatus."""
_STATUS_OF = {SUCCEEDED: _SUCCEEDED, CANCELED: _PREEMPTED, ABORTED: _ABORTED}
"""The ROS 1 number of each final status."""
_STATUS_INTERVAL = 0.2
"""Seconds between two messages of the topic `status`. Clients of actionlib treat a goal missing there as lost."""
_LISTED_AFTER_END = 5.0
"""Seconds that the topic `status` lists a goal after its end, as in actionlib."""
_SERVER_TIMEOUT = 3.0
"""Seconds without a `status` message, or with none that lists the goal, after which the server counts as gone."""
_RESEND_INTERVAL = 0.2
"""Seconds until an unlisted goal is sent again. rospy drops a message if the subscriber is not connected yet."""
_POLL_INTERVAL = 0.02
"""Seconds between two checks of a goal."""


class _Served:
    """A goal of a ROS client, for the PLC to execute. Implements the protocol `Goal` of backend.py."""

    def __init__(self, server: _Server, message: Any) -> None:
        self.request = message.goal
        self.goal_id = message.goal_id
        self.status = _PENDING
        self.ended: float | None = None
        self._server = server

    def progress(self, fill: Fill) -> None:
        self._server.progress(self, fill)

    def end(self, status: int, fill: Fill) -> None:
        self._server.end(self, _STATUS_OF[status], fill)


class _Server:
    """The server of a ROS 1 action. Thread-safe."""

    def __init__(self, backend: Backend, wire: ActionWire, worker: Worker, errors: ErrorSink) -> None:
        topics = _ActionTopics(wire)
        self._backend = backend
        self._worker = worker
        self._goals: dict[str, _Served] = {}
        self._lock = threading.Lock()
        self._feedback, self._result = backend.publisher(topics.feedback), backend.publisher(topics.result)
        self._status = backend.publisher(topics.status)
        backend.subscribe(topics.cancel, self._cancel, errors)
        backend.subscribe(topics.goal, self._goal, errors)
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

    def _cancel(self, selection: Any) -> None:
        """Cancel the goals that `selection`, a GoalID, selects: by id, up to a time, or all if both are empty."""
        with self._lock:
            goals = [goal for goal in self._goals.values() if goal.ended is None]
        for goal in goals:
            is_for_all = not selection.id and not selection.stamp
            is_older = selection.stamp and goal.goal_id.stamp <= selection.stamp
            if (is_for_all or is_older or goal.goal_id.id == selection.id) and self._worker.cancel(goal):
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
            since = time.monotonic() - _LISTED_AFTER_END
            self._goals = {key: goal for key, goal in self._goals.items() if not goal.ended or goal.ended >= since}
            message.status_list = [
                SimpleNamespace(goal_id=goal.goal_id, status=goal.status, text="") for goal in self._goals.values()
            ]
            self._status.send(message)

    def _repeat(self) -> None:
        with suppress(Exception):  # rospy has shut down
            while self._backend.alive():
                self._show()
                time.sleep(_STATUS_INTERVAL)


class _Sent:
    """A goal that the bridge sent, and its observer. `seen_at` is the monotonic time of its last status, in seconds."""

    def __init__(self, observer: GoalObserver) -> None:
        self.observer = observer
        self.status: int | None = None
        self.seen_at = time.monotonic()


class _Client:
    """A client of a ROS 1 action, with the interface of a RosActionClient."""

    def __init__(self, backend: Backend, wire: ActionWire, errors: ErrorSink) -> None:
        topics = _ActionTopics(wire)
        self._backend = backend
        self._sent: dict[str, _Sent] = {}
        self._lock = threading.Lock()
        self._last_status_at = -_SERVER_TIMEOUT
        self._canceling, self._goal = backend.publisher(topics.cancel), backend.publisher(topics.goal)
        backend.subscribe(topics.status, self._take_status, errors)
        backend.subscribe(topics.feedback, self._take_feedback, errors)
        backend.subscribe(topics.result, self._take_result, errors)

    def send(self, fill: Fill, timeout: float, observer: GoalObserver) -> Callable[[], object] | None:
        key = f"shmgen-{uuid.uuid4().hex}"
        message = self._goal.new()
        message.header.stamp = set_clock(message.header.stamp, self._backend.now())
        message.goal_id.stamp = set_clock(message.goal_id.stamp, self._backend.now())
        message.goal_id.id = key
        fill(message.goal)
        deadline = await_server(lambda: time.monotonic() - self._last_status_at < _SERVER_TIMEOUT, timeout)
        sent = self._sent[key] = _Sent(observer)
        try:
            due = 0.0
            while sent.status is None or sent.status == _PENDING:
                if sent.status is None and time.monotonic() >= due:
                    self._goal.send(message)
                    due = time.monotonic() + _RESEND_INTERVAL
                if time.monotonic() >= deadline:
                    raise NoAnswer(f"no answer within {timeout:g} s; the goal is cancelled")
                time.sleep(_POLL_INTERVAL)
        except BaseException:
            self._sent.pop(key, None)
            threading.Thread(target=self._cancel, args=(key,), daemon=True).start()
            raise
        if sent.status == _REJECTED:
            self._sent.pop(key, None)
            return None
        threading.Thread(target=self._watch, args=(key, sent), daemon=True).start()
        return lambda: self._cancel(key)

    def _take_status(self, message: Any) -> None:
        self._last_status_at = time.monotonic()
        for status in message.status_list:
            if sent := self._sent.get(status.goal_id.id):
                sent.status, sent.seen_at = status.status, self._last_status_at

    def _take_feedback(self, message: Any) -> None:
        with self._lock:
            if sent := self._sent.get(message.status.goal_id.id):
                sent.status, sent.seen_at = message.status.status, time.monotonic()
                sent.observer.feedback(message.feedback)

    def _take_result(self, message: Any) -> None:
        with self._lock:
            if sent := self._sent.pop(message.status.goal_id.id, None):
                sent.status = message.status.status
                ends = {theirs: ours for ours, theirs in _STATUS_OF.items()}
                if sent.status != _REJECTED:
                    sent.observer.end(ends.get(sent.status, ABORTED), message.result)

    def _watch(self, key: str, sent: _Sent) -> None:
        while key in self._sent:
            time.sleep(_POLL_INTERVAL)
            if time.monotonic() - sent.seen_at >= _SERVER_TIMEOUT:
                with self._lock:
                    if self._sent.pop(key, None):
                        why = f"the server has not listed the goal in its status for {_SERVER_TIMEOUT:g} s"
                        sent.observer.end(ABORTED, None, why)

    def _cancel(self, key: str) -> None:
        message = self._canceling.new()
        message.id = key
        self._canceling.send(message)


class _ActionTopics:
    """The five topics of a ROS 1 action, with types as ROS 1 generates them from the .action file."""

    def __init__(self, wire: ActionWire) -> None:
        name = wire.type.name

        def topic(part: str, messages: tuple[Message, ...], head: str) -> Wire:
            *dependencies, own = messages
            inner = replace(own, name=TypeName(wire.type.package, "msg", f"{name}{part}"))
            text = f"Header header\n{head}\n{name}{part} {part.lower()}\n"
            whole = _message(TypeName(wire.type.package, "msg", f"{name}Action{part}"), text)
            parts = {message.name: message for message in (*dependencies, _HEADER, _GOAL_ID, _STATUS, inner)}
            return Wire(f"{wire.name}/{part.lower()}", (*parts.values(), whole), sample_size=wire.sample_size)

        self.goal = topic("Goal", wire.goal, "actionlib_msgs/GoalID goal_id")
        self.feedback = topic("Feedback", wire.feedback, "actionlib_msgs/GoalStatus status")
        self.result = topic("Result", wire.result, "actionlib_msgs/GoalStatus status")
        self.cancel = Wire(f"{wire.name}/cancel", (_GOAL_ID,))
        self.status = Wire(f"{wire.name}/status", (_HEADER, _GOAL_ID, _STATUS, _STATUSES), latch=True)


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
"""The text includes the constants, because ROS 1 counts them in md5 sums."""
_STATUSES = _message(TypeName("actionlib_msgs", "msg", "GoalStatusArray"), "Header header\nGoalStatus[] status_list\n")

serve, action_client = _Server, _Client
"""The two functions of the Actions protocol."""
