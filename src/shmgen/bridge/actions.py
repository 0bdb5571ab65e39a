"""Carries goals between a ROS action and the PLC, in either direction."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from math import inf
from typing import Any

from shmgen.bridge.backend import ABORTED, CANCELED, SUCCEEDED, Backend, Goal, NoAnswer
from shmgen.bridge.common.counters import Counters, describe
from shmgen.bridge.endpoint import POLL_INTERVAL, RegionEndpoint, WorkerSide
from shmgen.bridge.plan import CallRoute
from shmgen.bridge.services import count_unanswered
from shmgen.live.classes import call_class
from shmgen.runtime import ActionClient, ActionServer, Message, ServedGoal, ShmError, ValueRejected

_GOAL_POLL_INTERVAL = 0.005
"""The poll interval of a running goal in seconds. It is short because a region holds only the newest feedback."""
_LIVENESS_INTERVAL = 0.2
"""The interval in seconds at which the bridge checks whether the PLC is alive."""
_HEARTBEAT_INTERVAL = 1.0
"""The heartbeat interval in seconds of a goal without feedback, so that the PLC's tTimeout does not stop the goal."""
_CANCEL_TIMEOUT = 0.2
"""The time limit in seconds for a cancel request when the bridge stops. The report of an abort to ROS gets half."""


class PlcActionServer(WorkerSide):
    """Carries an action that the PLC serves: the PLC executes goals of ROS clients. A new goal aborts the old goal."""

    def __init__(self, route: CallRoute, counters: Counters) -> None:
        super().__init__(route, counters)
        self.end = RegionEndpoint(self._open_client, counters)
        self._lock = threading.Lock()
        """Held while a goal starts, is canceled, or is checked for feedback and a result."""
        self._goal: Goal | None = None
        self._goal_region: tuple[Any, int] = None, 0
        """The client that sent the goal, and its `reopen_count` then. If the count changes, no result can arrive."""
        self._outcome: Any = None
        self._due = 0.0

    def start(self, backend: Backend) -> None:
        backend.actions.serve(backend, self.route.wire, self, self.counters)
        self._thread.start()

    def begin(self, goal: Goal) -> bool:
        """Send the goal to the PLC. Return True if the PLC accepts the goal within the action's timeout."""
        with self._lock:
            self.counters.mark_received()
            try:
                client = self.end.require()
                client.send_goal(goal.request, self.route.entry.timeout)
                self._give_up("a newer goal has arrived")
                self._goal_region = client, client.reopen_count
                accepted = not self.stopping.is_set() and self._is_accepted(client)
            except Exception as error:  # NoServer, ValueRejected, or any exception of a ROS library
                count_unanswered(self.counters, error)
                self.end.discard_after(error)
                return False
            if accepted:
                self._goal = goal
            return accepted

    def cancel(self, goal: Goal) -> bool:
        """Request that the PLC cancel the goal. Return False if the goal has ended or the request fails."""
        with self._lock:
            client = self.end.current
            if goal is not self._goal or client is None:
                return False
            try:
                client.cancel()
            except ShmError as error:
                self.end.report(error)
                return False
            return True

    def stop(self) -> bool:
        """Cancel the running goal in the PLC, and report to its ROS client that the goal is aborted."""
        with self._lock:
            client = self.end.current
            if self._goal and client:
                with suppress(ShmError):
                    client.cancel()
                self._give_up("the bridge stops")
                time.sleep(_CANCEL_TIMEOUT / 2)
        return True

    def _open_client(self) -> ActionClient[Any, Any, Any]:
        client = call_class(ActionClient, self.route.kinds)(self.route.entry.name)
        client.cancel_former()
        return client

    def _step(self, client: ActionClient[Any, Any, Any] | None) -> float:
        with self._lock:
            if self._goal is None:
                return POLL_INTERVAL
            if client is None or (client, client.reopen_count) != self._goal_region:
                self._give_up(self.end.unavailable_reason or "the region was removed")
            else:
                self._follow(client)
        return _GOAL_POLL_INTERVAL

    def _is_accepted(self, client: ActionClient[Any, Any, Any]) -> bool:
        """Return True if the PLC accepts the sent goal. Raises NoAnswer, and cancels the goal, after the timeout."""
        timeout = self.route.entry.timeout
        deadline = time.monotonic() + timeout
        self._outcome = None
        while self._outcome is None and not client.status:
            self._outcome = client.poll()
            if self._outcome is None and (time.monotonic() >= deadline or self.stopping.is_set()):
                client.cancel()
                raise NoAnswer(f"the PLC did not accept the goal within {timeout:g} s; the goal is canceled")
            time.sleep(_GOAL_POLL_INTERVAL / 5)
        if self._outcome is None or self._outcome.status != self._outcome.REJECTED:
            return True
        self.counters.fail("the PLC has rejected a goal")
        return False

    def _follow(self, client: ActionClient[Any, Any, Any]) -> None:
        """Forward new feedback and the result to ROS. If the PLC is no longer alive, abort the goal."""
        assert self._goal
        outcome = self._outcome or client.poll()
        if feedback := client.feedback():
            self._publish_feedback(self._goal, feedback)
        if outcome is not None:
            goal, self._goal, self._outcome = self._goal, None, None
            status = outcome.status if outcome.status in (SUCCEEDED, CANCELED) else ABORTED
            goal.end(status, lambda empty: self._fill("_Result", outcome.result, empty))
            self.counters.passed += 1
        elif time.monotonic() >= self._due:
            if not client.server_is_ready():
                client.cancel()  # in case the PLC resumes
                self._give_up("the PLC is no longer running")
            self._due = time.monotonic() + _LIVENESS_INTERVAL

    def _publish_feedback(self, goal: Goal, feedback: Message) -> None:
        try:
            goal.progress(lambda empty: self._fill("_Feedback", feedback, empty))
        except Exception as error:  # a ROS library may raise any exception
            self.counters.reject(describe(error), " by ROS")

    def _give_up(self, why: str) -> None:
        goal, self._goal, self._outcome = self._goal, None, None
        if goal is not None:
            self.counters.fail(f"goal aborted: {why}")
            goal.end(ABORTED, lambda empty: None)

    def _fill(self, part: str, message: Message, empty: Any) -> None:
        self.route.kinds[part]._decode(bytes(message), empty)


class PlcActionClient(WorkerSide):
    """Carries an action that ROS serves: ROS executes the goals of the PLC. Each action has its own thread."""

    def __init__(self, route: CallRoute, counters: Counters) -> None:
        super().__init__(route, counters)
        kind = call_class(ActionServer, route.kinds)
        self.end: RegionEndpoint[ActionServer[Any]] = RegionEndpoint(lambda: kind(route.entry.name), counters)

    def start(self, backend: Backend) -> None:
        self._ros_client = backend.actions.action_client(backend, self.route.wire, self.counters)
        self._thread.start()

    def _step(self, plc: ActionServer[Any] | None) -> float:
        if plc is None:
            return POLL_INTERVAL
        if goal := plc.wait(POLL_INTERVAL):
            self.counters.mark_received()
            self._send(plc, goal)
        return 0.0

    def _send(self, plc: ActionServer[Any], goal: ServedGoal[Any]) -> None:
        news = _News()
        kind, timeout = self.route.kinds["_Goal"], self.route.entry.timeout
        try:
            cancel = self._ros_client.send(lambda empty: kind._decode(bytes(goal.request), empty), timeout, news)
        except Exception as error:  # NoAnswer, or any exception of a ROS library
            count_unanswered(self.counters, error)
            goal.abort()
            return
        if cancel is None:
            self.counters.fail("ROS has rejected a goal")
            goal.reject()
            return
        self._follow(plc, goal, news, cancel)

    def _follow(self, plc: ActionServer[Any], goal: ServedGoal[Any], news: _News, cancel: Callable[[], object]) -> None:
        """Forward feedback and the result to the PLC until the goal ends or the bridge stops.

        If the PLC sends a newer goal or disappears, cancel `goal`, and wait for its result up to the action's timeout.
        """
        canceling = threading.Thread(target=cancel, daemon=True)
        until, last_heartbeat = inf, -inf
        reopen_count = plc.reopen_count
        while time.monotonic() < until and not self.stopping.is_set():
            try:
                now = time.monotonic()
                for feedback in news.pop_feedback():
                    self._publish_feedback(goal, feedback)
                if news.outcome:
                    self._finish(goal, *news.outcome)
                    return
                is_unwanted = goal.is_cancel_requested
                is_replaced = self.end.current is not plc or plc.reopen_count != reopen_count
                if is_replaced or not goal.is_awaited or not plc.client_lives():
                    is_unwanted, until = True, min(until, now + self.route.entry.timeout)
                if is_unwanted and canceling.ident is None:
                    canceling.start()
                if not news.is_any and now >= last_heartbeat + _HEARTBEAT_INTERVAL:
                    goal.accept()
                    last_heartbeat = now
            except (ShmError, OSError) as error:
                self.end.report(error)
            news.arrived.wait(_GOAL_POLL_INTERVAL)
        if canceling.ident is None:
            canceling.start()
        canceling.join(_CANCEL_TIMEOUT)
        self.counters.failed += 1
        with suppress(ShmError):
            goal.abort()

    def _publish_feedback(self, goal: ServedGoal[Any], feedback: Any) -> None:
        try:
            goal.publish_feedback(feedback)
        except ValueRejected as error:
            self.counters.reject(str(error))

    def _finish(self, goal: ServedGoal[Any], status: int, result: Any, why: str) -> None:
        """Send the result to the PLC, or abort the goal for the reason `why`. Raises ShmError if the region fails."""
        if result is None:
            goal.abort()
            self.counters.fail(f"goal aborted: {why}")
            return
        try:
            {SUCCEEDED: goal.succeed, CANCELED: goal.canceled}.get(status, goal.abort)(result)
            self.counters.passed += 1
        except ValueRejected as error:
            goal.abort()
            self.counters.reject(str(error))


class _News:
    """A GoalObserver that stores the feedback and the result of a goal until another thread reads them."""

    def __init__(self) -> None:
        self.arrived = threading.Event()
        self.is_any = False
        self.outcome: tuple[int, Any, str] | None = None
        self._feedback: deque[Any] = deque()

    def feedback(self, feedback: Any) -> None:
        self.is_any = True
        self._feedback.append(feedback)
        self.arrived.set()

    def end(self, status: int, result: Any, why: str = "") -> None:
        self.outcome = status, result, why
        self.arrived.set()

    def pop_feedback(self) -> list[Any]:
        """Return the feedback messages that arrived since the last call."""
        self.arrived.clear()
        return [self._feedback.popleft() for _ in range(len(self._feedback))]
