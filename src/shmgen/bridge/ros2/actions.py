"""An action as ROS 2 has it: three services and two topics.

Source: the ROS 2 design article *Actions*, rcl_action, and the .msg and .srv files of action_msgs.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
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
    ServiceWire,
    Wire,
    Worker,
    await_server,
)
from shmgen.core.model import Array, Clock, FieldType, Message, Ref, Scalar, Sequence, TypeName
from shmgen.core.type_hash import made_message
from shmgen.runtime import Time

_UNKNOWN, _ACCEPTED, _EXECUTING, _CANCELING = range(4)
"""Of action_msgs/GoalStatus, beside those of backend.py."""
_NONE, _REJECTED, _UNKNOWN_GOAL, _TERMINATED = range(4)
"""What action_msgs/CancelGoal returns."""
_KEPT = 16
"""Goals whose end can still be asked for."""
_FOREVER = 1e9
"""Seconds that a goal may take."""
_GONE = 2.0
"""Seconds that a cancel may take of a goal that nobody waits for any more."""


class _Served:
    """A Goal of a ROS client."""

    def __init__(self, server: _Server, key: bytes, stamp: Time, request: Any) -> None:
        self.key, self.stamp, self.request = key, stamp, request
        self.status = _UNKNOWN
        self.ended = threading.Event()
        self.fill: Fill
        self._server = server

    def progress(self, fill: Fill) -> None:
        self._server.progress(self, fill)

    def end(self, status: int, fill: Fill) -> None:
        if not self.ended.is_set():
            self.fill = fill
            self._server.show(self, status)
            self.ended.set()


class _Server:
    """All its methods may be called from any thread."""

    def __init__(self, backend: Backend, wire: ActionWire, worker: Worker, mishaps: ErrorSink) -> None:
        self._worker = worker
        self._now = backend.now
        self._goals: dict[bytes, _Served] = {}
        self._lock = threading.Lock()
        said = Said(wire)
        self._feedback = backend.publisher(said.feedback)
        self._status = backend.publisher(said.status)
        backend.serve(said.result, self._result, mishaps.refuse)
        backend.serve(said.cancel, self._cancel, mishaps.refuse)
        backend.serve(said.send, self._send, mishaps.refuse)

    def progress(self, goal: _Served, fill: Fill) -> None:
        message = self._feedback.new()
        message.goal_id.uuid[:] = list(goal.key)
        fill(message.feedback)
        self._feedback.send(message)

    def show(self, goal: _Served, status: int) -> None:
        """In the topic of all goals."""
        with self._lock:
            if goal.ended.is_set():
                return
            goal.status = status
            message = self._status.new()
            message.status_list = [
                SimpleNamespace(goal_info=_info(one), status=one.status) for one in self._goals.values()
            ]
            self._status.send(message)

    def _send(self, request: Any, response: Any) -> None:
        goal = _Served(self, bytes(request.goal_id.uuid), self._now(), request.goal)
        with self._lock:
            known = goal.key in self._goals
            if not known:
                self._forget()
                self._goals[goal.key] = goal
        response.accepted = not known and self._worker.begin(goal)
        response.stamp.sec, response.stamp.nanosec = goal.stamp.sec, goal.stamp.nanosec
        if response.accepted:
            self.show(goal, _EXECUTING)
        elif not known:
            with self._lock:
                del self._goals[goal.key]

    def _result(self, request: Any, response: Any) -> None:
        goal = self._goals.get(bytes(request.goal_id.uuid))
        if goal is not None:  # else its status is the UNKNOWN of an empty response
            goal.ended.wait()
            response.status = goal.status
            goal.fill(response.result)

    def _cancel(self, request: Any, response: Any) -> None:
        wanted, code = self._wanted(request.goal_info)
        canceled = []
        for goal in wanted:
            if self._worker.cancel(goal):
                self.show(goal, _CANCELING)
                canceled.append(goal)
        response.return_code = _REJECTED if wanted and not canceled else code
        response.goals_canceling = [_info(goal) for goal in canceled]

    def _wanted(self, info: Any) -> tuple[list[_Served], int]:
        """Those that action_msgs/CancelGoal means: one, those that are not younger than the stamp, or all."""
        key, until = bytes(info.goal_id.uuid), (info.stamp.sec, info.stamp.nanosec)
        with self._lock:
            goals = list(self._goals.values())
        named = [goal for goal in goals if goal.key == key]
        if any(key) and until == (0, 0):
            if not named:
                return [], _UNKNOWN_GOAL
            return ([], _TERMINATED) if named[0].ended.is_set() else (named, _NONE)
        everything = not any(key) and until == (0, 0)
        old = [goal for goal in goals if everything or goal in named or tuple(goal.stamp) <= until]
        return [goal for goal in old if not goal.ended.is_set()], _NONE

    def _forget(self) -> None:
        """The oldest of those that have ended, as ROS 2 does after some time."""
        ended = [key for key, goal in self._goals.items() if goal.ended.is_set()]
        for key in ended[: max(0, len(ended) - _KEPT + 1)]:
            del self._goals[key]


class _Client:
    """A RosActionClient, and the MessageSink of the feedback."""

    def __init__(self, backend: Backend, wire: ActionWire, mishaps: ErrorSink) -> None:
        self.reject, self.refuse, self.meet, self.lose = mishaps.reject, mishaps.refuse, mishaps.meet, mishaps.lose
        said = Said(wire)
        self._followers: dict[bytes, _Once] = {}
        self._sending = backend.client(said.send)
        self._canceling = backend.client(said.cancel)
        self._results = backend.client(said.result)
        self._feedback = backend.subscribe(said.feedback, self)

    def take(self, message: Any) -> None:
        follower = self._followers.get(bytes(message.goal_id.uuid))
        if follower:
            follower.feedback(message.feedback)

    def send(self, fill: Fill, timeout: float, follower: GoalObserver) -> Callable[[], threading.Thread] | None:
        # All of it: discovery brings its ends one after another, and the first feedback would come to nobody.
        ends = (self._sending, self._results, self._canceling, self._feedback)
        await_server(lambda: all(end.is_connected() for end in ends), timeout)
        key = uuid.uuid4().bytes
        request = self._sending.new()
        request.goal_id.uuid[:] = list(key)
        fill(request.goal)
        self._followers[key] = _Once(follower)
        try:
            accepted = self._sending.call(request, timeout).accepted
        except NoAnswer:
            del self._followers[key]
            self._cancel(key)  # it may come too late
            raise
        if not accepted:
            del self._followers[key]
            return None
        threading.Thread(target=self._await, args=(key,), daemon=True).start()
        return lambda: self._cancel(key)

    def _await(self, key: bytes) -> None:
        request = self._results.new()
        request.goal_id.uuid[:] = list(key)
        try:
            response = self._results.call(request, _FOREVER)
            if response.status in (SUCCEEDED, CANCELED, ABORTED):
                self._followers.pop(key).end(response.status, response.result)
            else:
                self._followers.pop(key).end(ABORTED, None, "the server does not know the goal")
        except Exception as error:
            self._followers.pop(key).end(ABORTED, None, str(error))

    def _cancel(self, key: bytes) -> threading.Thread:
        def run() -> None:
            request = self._canceling.new()
            request.goal_info.goal_id.uuid[:] = list(key)
            with suppress(Exception):  # how the goal ends says the rest
                self._canceling.call(request, _GONE)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        return thread


class _Once:
    """Hands over one after another, and nothing behind the end."""

    def __init__(self, follower: GoalObserver) -> None:
        self._follower = follower
        self._lock = threading.Lock()
        self._ended = False

    def feedback(self, feedback: Any) -> None:
        with self._lock:
            if not self._ended:
                self._follower.feedback(feedback)

    def end(self, status: int, result: Any, why: str = "") -> None:
        with self._lock:
            self._ended = True
            self._follower.end(status, result, why)


def _info(goal: _Served) -> Any:
    """An action_msgs/GoalInfo."""
    return SimpleNamespace(
        goal_id=SimpleNamespace(uuid=goal.key), stamp=SimpleNamespace(sec=goal.stamp.sec, nanosec=goal.stamp.nanosec)
    )


class Said:
    """The wires of an action."""

    def __init__(self, wire: ActionWire) -> None:
        def message(ending: str, held: Iterable[Message], fields: Mapping[str, FieldType]) -> tuple[Message, ...]:
            return _closed(held, made_message(wire.type.part(ending), fields))

        def part(messages: tuple[Message, ...]) -> Ref:
            return Ref(messages[-1].name)

        place = f"{wire.action}/_action"
        uuid_, status = {"goal_id": Ref(_UUID.name)}, {"status": Scalar.INT8}
        self.send = ServiceWire(
            f"{place}/send_goal",
            message("_SendGoal_Request", (_UUID, *wire.goal), {**uuid_, "goal": part(wire.goal)}),
            message("_SendGoal_Response", (), {"accepted": Scalar.BOOL, "stamp": Clock.TIME}),
        )
        self.result = ServiceWire(
            f"{place}/get_result",
            message("_GetResult_Request", (_UUID,), uuid_),
            message("_GetResult_Response", wire.result, {**status, "result": part(wire.result)}),
            at_once=True,
        )
        self.cancel = ServiceWire(f"{place}/cancel_goal", _CANCEL_REQUEST, _CANCEL_RESPONSE)
        feedback = message("_FeedbackMessage", (_UUID, *wire.feedback), {**uuid_, "feedback": part(wire.feedback)})
        self.feedback = Wire(f"{place}/feedback", feedback, room=wire.room)
        self.status = Wire(f"{place}/status", _STATUSES, latch=True)


def _closed(held: Iterable[Message], own: Message) -> tuple[Message, ...]:
    """Each once, and the message last."""
    return (*dict.fromkeys(held), own)


_UUID = made_message(TypeName("unique_identifier_msgs", "msg", "UUID"), {"uuid": Array(Scalar.UINT8, 16)})
_INFO = made_message(
    TypeName("action_msgs", "msg", "GoalInfo"),
    {"goal_id": Ref(TypeName("unique_identifier_msgs", "msg", "UUID")), "stamp": Clock.TIME},
)
_STATUS = made_message(
    TypeName("action_msgs", "msg", "GoalStatus"), {"goal_info": Ref(_INFO.name), "status": Scalar.INT8}
)
_STATUSES = (
    _UUID,
    _INFO,
    _STATUS,
    made_message(TypeName("action_msgs", "msg", "GoalStatusArray"), {"status_list": Sequence(Ref(_STATUS.name))}),
)
_CANCEL = TypeName("action_msgs", "srv", "CancelGoal")
_CANCEL_REQUEST = (_UUID, _INFO, made_message(_CANCEL.part("_Request"), {"goal_info": Ref(_INFO.name)}))
_CANCEL_RESPONSE = (
    _UUID,
    _INFO,
    made_message(_CANCEL.part("_Response"), {"return_code": Scalar.INT8, "goals_canceling": Sequence(Ref(_INFO.name))}),
)

serve, seeker = _Server, _Client
"""As Actions says it."""
