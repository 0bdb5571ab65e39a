"""Actions of ROS 2: each consists of three services and two topics.

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
)
from shmgen.bridge.common.support import await_server
from shmgen.core.model import Array, Clock, FieldType, Message, Ref, Scalar, Sequence, TypeName
from shmgen.core.type_hash import create_message
from shmgen.runtime import Time

_UNKNOWN, _ACCEPTED, _EXECUTING, _CANCELING = range(4)
"""Status numbers of action_msgs/GoalStatus. The final ones are in backend.py."""
_NONE, _REJECTED, _UNKNOWN_GOAL, _TERMINATED = range(4)
"""Return codes of action_msgs/CancelGoal."""
_MAX_ENDED_GOALS = 16
"""Maximum number of ended goals whose result clients can still request."""
_NO_TIMEOUT = 1e9
"""Seconds that a goal may take: practically no limit."""
_CANCEL_TIMEOUT = 2.0
"""Timeout in seconds of a cancel request."""


class _Served:
    """A goal of a ROS client, for the PLC to execute. Implements the protocol `Goal` of backend.py."""

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
    """The server of a ROS 2 action. Thread-safe."""

    def __init__(self, backend: Backend, wire: ActionWire, worker: Worker, errors: ErrorSink) -> None:
        self._worker = worker
        self._now = backend.now
        self._goals: dict[bytes, _Served] = {}
        self._lock = threading.Lock()
        interface = ActionInterface(wire)
        self._feedback = backend.publisher(interface.feedback)
        self._status = backend.publisher(interface.status)
        backend.serve(interface.result, self._result, errors)
        backend.serve(interface.cancel, self._cancel, errors)
        backend.serve(interface.send, self._send, errors)

    def progress(self, goal: _Served, fill: Fill) -> None:
        message = self._feedback.new()
        message.goal_id.uuid[:] = list(goal.key)
        fill(message.feedback)
        self._feedback.send(message)

    def show(self, goal: _Served, status: int) -> None:
        """Set the status of a goal and publish the status of all goals."""
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
        if goal is not None:  # otherwise the empty response has the status UNKNOWN
            goal.ended.wait()
            response.status = goal.status
            goal.fill(response.result)

    def _cancel(self, request: Any, response: Any) -> None:
        selected, code = self._selected_goals(request.goal_info)
        canceled = []
        for goal in selected:
            if self._worker.cancel(goal):
                self.show(goal, _CANCELING)
                canceled.append(goal)
        response.return_code = _REJECTED if selected and not canceled else code
        response.goals_canceling = [_info(goal) for goal in canceled]

    def _selected_goals(self, info: Any) -> tuple[list[_Served], int]:
        """Return the running goals that a cancel request selects (by id, by time, or all), and its return code."""
        key, until = bytes(info.goal_id.uuid), (info.stamp.sec, info.stamp.nanosec)
        with self._lock:
            goals = list(self._goals.values())
        by_id = [goal for goal in goals if goal.key == key]
        if any(key) and until == (0, 0):
            if not by_id:
                return [], _UNKNOWN_GOAL
            return ([], _TERMINATED) if by_id[0].ended.is_set() else (by_id, _NONE)
        is_for_all = not any(key) and until == (0, 0)
        older = [goal for goal in goals if is_for_all or goal in by_id or tuple(goal.stamp) <= until]
        return [goal for goal in older if not goal.ended.is_set()], _NONE

    def _forget(self) -> None:
        """Forget the oldest ended goals, to keep at most 16 with the next one. rcl_action instead has a timeout."""
        ended = [key for key, goal in self._goals.items() if goal.ended.is_set()]
        for key in ended[: max(0, len(ended) - _MAX_ENDED_GOALS + 1)]:
            del self._goals[key]


class _Client:
    """A client of a ROS 2 action, with the interface of a RosActionClient."""

    def __init__(self, backend: Backend, wire: ActionWire, errors: ErrorSink) -> None:
        interface = ActionInterface(wire)
        self._observers: dict[bytes, GoalObserver] = {}
        self._sending = backend.client(interface.send)
        self._canceling = backend.client(interface.cancel)
        self._results = backend.client(interface.result)
        self._feedback = backend.subscribe(interface.feedback, self._take_feedback, errors)

    def _take_feedback(self, message: Any) -> None:
        observer = self._observers.get(bytes(message.goal_id.uuid))
        if observer:
            observer.feedback(message.feedback)

    def send(self, fill: Fill, timeout: float, observer: GoalObserver) -> Callable[[], object] | None:
        # Wait for all endpoints: they are discovered one by one, and the first feedback would be lost.
        ends = (self._sending, self._results, self._canceling, self._feedback)
        await_server(lambda: all(end.is_connected() for end in ends), timeout)
        key = uuid.uuid4().bytes
        request = self._sending.new()
        request.goal_id.uuid[:] = list(key)
        fill(request.goal)
        self._observers[key] = observer
        try:
            accepted = self._sending.call(request, timeout).accepted
        except NoAnswer:
            del self._observers[key]
            # The server may still accept the goal later.
            threading.Thread(target=self._cancel, args=(key,), daemon=True).start()
            raise
        if not accepted:
            del self._observers[key]
            return None
        threading.Thread(target=self._await, args=(key,), daemon=True).start()
        return lambda: self._cancel(key)

    def _await(self, key: bytes) -> None:
        request = self._results.new()
        request.goal_id.uuid[:] = list(key)
        try:
            response = self._results.call(request, _NO_TIMEOUT)
            if response.status in (SUCCEEDED, CANCELED, ABORTED):
                self._observers.pop(key).end(response.status, response.result)
            else:
                self._observers.pop(key).end(ABORTED, None, "the server does not know the goal")
        except Exception as error:
            self._observers.pop(key).end(ABORTED, None, str(error))

    def _cancel(self, key: bytes) -> None:
        request = self._canceling.new()
        request.goal_info.goal_id.uuid[:] = list(key)
        with suppress(Exception):  # the end of the goal reports the outcome
            self._canceling.call(request, _CANCEL_TIMEOUT)


def _info(goal: _Served) -> Any:
    """Return the action_msgs/GoalInfo of a goal."""
    return SimpleNamespace(goal_id=SimpleNamespace(uuid=goal.key), stamp=goal.stamp)


class ActionInterface:
    """The services and topics of which a ROS 2 action consists."""

    def __init__(self, wire: ActionWire) -> None:
        def message(
            ending: str, dependencies: Iterable[Message], fields: Mapping[str, FieldType]
        ) -> tuple[Message, ...]:
            """Return the dependencies without duplicates, followed by a message with these `fields`."""
            return (*dict.fromkeys(dependencies), create_message(wire.type.part(ending), fields))

        def part(messages: tuple[Message, ...]) -> Ref:
            return Ref(messages[-1].name)

        prefix = f"{wire.name}/_action"
        uuid_, status = {"goal_id": Ref(_UUID.name)}, {"status": Scalar.INT8}
        self.send = ServiceWire(
            f"{prefix}/send_goal",
            message("_SendGoal_Request", (_UUID, *wire.goal), {**uuid_, "goal": part(wire.goal)}),
            message("_SendGoal_Response", (), {"accepted": Scalar.BOOL, "stamp": Clock.TIME}),
        )
        self.result = ServiceWire(
            f"{prefix}/get_result",
            message("_GetResult_Request", (_UUID,), uuid_),
            message("_GetResult_Response", wire.result, {**status, "result": part(wire.result)}),
            at_once=True,
        )
        self.cancel = ServiceWire(f"{prefix}/cancel_goal", _CANCEL_REQUEST, _CANCEL_RESPONSE)
        feedback = message("_FeedbackMessage", (_UUID, *wire.feedback), {**uuid_, "feedback": part(wire.feedback)})
        self.feedback = Wire(f"{prefix}/feedback", feedback, sample_size=wire.sample_size)
        self.status = Wire(f"{prefix}/status", _STATUSES, latch=True)


_UUID = create_message(TypeName("unique_identifier_msgs", "msg", "UUID"), {"uuid": Array(Scalar.UINT8, 16)})
_INFO = create_message(TypeName("action_msgs", "msg", "GoalInfo"), {"goal_id": Ref(_UUID.name), "stamp": Clock.TIME})
_STATUS = create_message(
    TypeName("action_msgs", "msg", "GoalStatus"), {"goal_info": Ref(_INFO.name), "status": Scalar.INT8}
)
_STATUSES = (
    _UUID,
    _INFO,
    _STATUS,
    create_message(TypeName("action_msgs", "msg", "GoalStatusArray"), {"status_list": Sequence(Ref(_STATUS.name))}),
)
_CANCEL = TypeName("action_msgs", "srv", "CancelGoal")
_CANCEL_REQUEST = (_UUID, _INFO, create_message(_CANCEL.part("_Request"), {"goal_info": Ref(_INFO.name)}))
_CANCEL_RESPONSE = (
    _UUID,
    _INFO,
    create_message(
        _CANCEL.part("_Response"), {"return_code": Scalar.INT8, "goals_canceling": Sequence(Ref(_INFO.name))}
    ),
)

serve, action_client = _Server, _Client
"""The two functions of the Actions protocol."""
