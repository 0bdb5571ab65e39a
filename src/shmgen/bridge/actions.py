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
from shmgen.bridge.counters import Counters
from shmgen.bridge.endpoint import LOOK, ReopeningEndpoint, WorkerThread
from shmgen.bridge.plan import ActionRoute
from shmgen.bridge.services import unanswered
from shmgen.live.classes import action_client, action_server
from shmgen.runtime import ActionClient, ActionServer, Message, RegionInUse, ServedGoal, ShmError, ValueRejected

_POLL = 0.005
"""Seconds between two looks at a goal that is under way; of a region's feedback there is the newest only."""
_ALIVE = 0.2
"""Seconds between two looks whether the PLC is there."""
_SIGN = 1.0
"""Seconds between two signs of life to a PLC whose goal has no feedback yet; its block gives up after tTimeout."""
_FAREWELL = 0.2
"""Seconds that a cancel gets to be sent when the bridge ends; the end of a goal gets half of it."""


class PlcActionServer:
    """A Side, and a Worker: ROS sends goals, the PLC reaches them, one at a time; a newer one ends the one before."""

    def __init__(self, route: ActionRoute, counters: Counters, stopping: threading.Event) -> None:
        self.about = route.about
        self.counters = counters
        self._route = route
        self._stopping = stopping
        self.end = ReopeningEndpoint(self._opened, counters, stopping)
        self.beat, self.close = self.end.beat, self.end.close
        self._client: ActionClient[Any, Any, Any] | None = None
        self._goal: Goal | None = None
        self._outcome: Any = None
        self._due = 0.0
        self._loop = WorkerThread(self._step, self.end, stopping)

    def join(self, backend: Backend) -> None:
        backend.actions.serve(backend, self._route.wire, self, self.counters)
        self._loop.start()

    def begin(self, goal: Goal) -> bool:
        """Whether the PLC accepts it, which it says within `timeout`."""
        with self.end.lock:
            self.counters.came()
            try:
                client = self._client = self.end.look()
                if client is None:
                    raise NoAnswer(f"there is no region: {self.end.why}")
                client.send_goal(goal.request, self._route.action.timeout)
                self._give_up("a newer goal has come")
                accepted = not self._stopping.is_set() and self._accepted(client)
            except Exception as error:  # NoServer, ValueRejected, or whatever a ROS may raise
                unanswered(self.counters, error)
                if isinstance(error, RegionInUse):
                    self.end.lose(str(error))
                return False
            if accepted:
                self._goal = goal
            return accepted

    def cancel(self, goal: Goal) -> bool:
        """Asks the PLC to end it."""
        with self.end.lock:
            if goal is not self._goal or self.end.now is None:
                return False
            try:
                self.end.now.cancel()
            except ShmError as error:
                self.end.meet(error)
                return False
            return True

    def leave(self) -> None:
        with self.end.lock:
            if self._goal and self.end.now:
                with suppress(ShmError):
                    self.end.now.cancel()
                self._give_up("the bridge ends")
                time.sleep(_FAREWELL / 2)

    def _opened(self) -> ActionClient[Any, Any, Any]:
        made = action_client(self._route.kinds)(self._route.action.name)
        made.cancel_former()
        return made

    def _step(self, client: ActionClient[Any, Any, Any] | None) -> float:
        if self._goal is None:
            return LOOK
        if client is None or client is not self._client:
            self._give_up(f"there is no region: {self.end.why}")
        else:
            self._follow(client)
        return _POLL

    def _accepted(self, client: ActionClient[Any, Any, Any]) -> bool:
        """A goal of which nothing is heard is cancelled: a PLC that sends one gives it up likewise."""
        timeout = self._route.action.timeout
        deadline = time.monotonic() + timeout
        self._outcome = None
        while self._outcome is None and not client.status:
            self._outcome = client.poll()
            if self._outcome is None and (time.monotonic() >= deadline or self._stopping.is_set()):
                client.cancel()
                raise NoAnswer(f"not a word about the goal within {timeout:g} s; it is cancelled")
            time.sleep(_POLL / 5)
        if self._outcome is None or self._outcome.status != self._outcome.REJECTED:
            return True
        self.counters.failed += 1
        self.counters.complain("the PLC has rejected a goal")
        return False

    def _follow(self, client: ActionClient[Any, Any, Any]) -> None:
        """Passes on what is new of the goal."""
        assert self._goal
        outcome = self._outcome or client.poll()
        if feedback := client.feedback():
            self._pass_on(self._goal, feedback)
        if outcome is not None:
            goal, self._goal, self._outcome = self._goal, None, None
            status = outcome.status if outcome.status in (SUCCEEDED, CANCELED) else ABORTED
            goal.end(status, lambda empty: self._fill("_Result", outcome.result, empty))
            self.counters.passed += 1
        elif time.monotonic() >= self._due:
            if not client.server_is_ready():
                client.cancel()  # should it go on
                self._give_up("the PLC has gone")
            self._due = time.monotonic() + _ALIVE

    def _pass_on(self, goal: Goal, feedback: Message) -> None:
        try:
            goal.progress(lambda empty: self._fill("_Feedback", feedback, empty))
        except Exception as error:  # whatever a ROS may raise
            self.counters.reject(f"{type(error).__name__}: {error}", " by ROS")

    def _give_up(self, why: str) -> None:
        goal, self._goal, self._outcome = self._goal, None, None
        if goal is not None:
            self.counters.failed += 1
            self.counters.complain(f"goal aborted: {why}")
            goal.end(ABORTED, lambda empty: None)

    def _fill(self, part: str, message: Message, empty: Any) -> None:
        self._route.kinds[part]._decode(bytes(message), 0, empty)


class PlcActionClient:
    """A Side: the PLC sends goals, ROS reaches them, in a thread of the action's own."""

    def __init__(self, route: ActionRoute, counters: Counters, stopping: threading.Event) -> None:
        self.about = route.about
        self.counters = counters
        self._route = route
        self._stopping = stopping
        made = action_server(route.kinds)
        self.end: ReopeningEndpoint[ActionServer[Any]] = ReopeningEndpoint(
            lambda: made(route.action.name), counters, stopping
        )
        self._loop = WorkerThread(self._step, self.end, stopping)
        self.beat, self.close = self.end.beat, self.end.close
        self.leave = self._loop.leave  # it cancels what is under way

    def join(self, backend: Backend) -> None:
        self._seeker = backend.actions.seeker(backend, self._route.wire, self.counters)
        self._loop.start()

    def _step(self, served: ActionServer[Any] | None) -> float:
        if served is None:
            return LOOK
        if goal := served.wait(LOOK):
            self.counters.came()
            self._seek(served, goal)
        return 0.0

    def _seek(self, served: ActionServer[Any], goal: ServedGoal[Any]) -> None:
        news = _News()
        kind, timeout = self._route.kinds["_Goal"], self._route.action.timeout
        try:
            cancel = self._seeker.send(lambda empty: kind._decode(bytes(goal.request), 0, empty), timeout, news)
        except Exception as error:  # NoAnswer, or whatever a ROS may raise
            unanswered(self.counters, error)
            goal.abort()
            return
        if cancel is None:
            self.counters.failed += 1
            self.counters.complain("ROS has rejected a goal")
            goal.reject()
            return
        self._follow(served, goal, news, cancel)

    def _follow(
        self, served: ActionServer[Any], goal: ServedGoal[Any], news: _News, cancel: Callable[[], threading.Thread]
    ) -> None:
        """Until it has ended, or for `timeout` seconds after the PLC has sent a newer goal or is there no more."""
        canceling: threading.Thread | None = None
        until, signed = inf, -inf
        while time.monotonic() < until and not self._stopping.is_set():
            try:
                now = time.monotonic()
                for feedback in news.taken():
                    self._pass_on(goal, feedback)
                if news.outcome:
                    self._finish(goal, *news.outcome)
                    return
                is_unwanted = goal.is_cancel_requested
                if not goal.is_awaited or self.end.look() is not served or not served.client_lives():
                    is_unwanted, until = True, min(until, now + self._route.action.timeout)
                if is_unwanted:
                    canceling = canceling or cancel()
                if not news.is_any and now >= signed + _SIGN:
                    goal.accept()
                    signed = now
            except (ShmError, OSError) as error:
                self.end.meet(error)
            news.came.wait(_POLL)
        (canceling or cancel()).join(_FAREWELL)
        self.counters.failed += 1
        with suppress(ShmError):
            goal.abort()

    def _pass_on(self, goal: ServedGoal[Any], feedback: Any) -> None:
        try:
            goal.publish_feedback(feedback)
        except ValueRejected as error:
            self.counters.reject(str(error))

    def _finish(self, goal: ServedGoal[Any], status: int, result: Any, why: str) -> None:
        """Raises ShmError, and can be tried again."""
        if result is None:
            goal.abort()
            self.counters.failed += 1
            self.counters.complain(f"goal aborted: {why}")
            return
        try:
            {SUCCEEDED: goal.succeed, CANCELED: goal.canceled}.get(status, goal.abort)(result)
            self.counters.passed += 1
        except ValueRejected as error:
            goal.abort()
            self.counters.reject(str(error))


class _News:
    """A Follower: what has come of a goal, for the thread that waits for it."""

    def __init__(self) -> None:
        self.came = threading.Event()
        self.is_any = False
        self.outcome: tuple[int, Any, str] | None = None
        self._feedback: deque[Any] = deque()

    def feedback(self, feedback: Any) -> None:
        self.is_any = True
        self._feedback.append(feedback)
        self.came.set()

    def end(self, status: int, result: Any, why: str = "") -> None:
        self.outcome = status, result, why
        self.came.set()

    def taken(self) -> list[Any]:
        """What has not been taken yet."""
        self.came.clear()
        return [self._feedback.popleft() for _ in range(len(self._feedback))]
