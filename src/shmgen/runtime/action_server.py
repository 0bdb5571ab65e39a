"""The server of an action: takes goals that come as commands in shared memory, and reports how they end."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from types import SimpleNamespace
from typing import Any, Generic, TypeVar

from shmgen.runtime.calls import CallServer, deadline_of, log_exception, skip_stale, until
from shmgen.runtime.errors import LockTimeout
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.resource import Closable
from shmgen.runtime.region.settings import UNTIL_RECOVERED
from shmgen.runtime.subscriber import Subscriber

Goal = TypeVar("Goal", bound=Message)


class ServedGoal(Generic[Goal]):
    """A goal that a server works on, with the words of rclpy's goal handle.

    Once the goal has ended or a newer one has arrived, its methods send nothing and return False. They raise
    ValueRejected for a value that does not fit, and LockTimeout.
    """

    def __init__(self, server: ActionServer[Goal], number: int, request: Goal) -> None:
        self.number = number
        self.request = request
        self._server = server

    @property
    def is_cancel_requested(self) -> bool:
        """Whether the client has requested a cancel, or sent a newer goal. Reading it is the server's heartbeat."""
        return self._server._unwanted(self.number)

    @property
    def is_awaited(self) -> bool:
        """Whether it has not ended, and no newer one has arrived."""
        return self._server._calls.awaits(self.number)

    def accept(self) -> bool:
        """Reports to the client that the goal has been accepted."""
        return self._server._accept(self.number)

    def publish_feedback(self, feedback: Any) -> bool:
        """Publishes the action's feedback: its message, or any object with the same attributes."""
        return self._server._publish_feedback(self.number, feedback)

    def succeed(self, result: Any) -> bool:
        """Ends the goal as SUCCEEDED."""
        return self._server._end(self.number, "SUCCEEDED", result)

    def abort(self, result: Any = None) -> bool:
        """Ends the goal as ABORTED, with a result or without."""
        return self._server._end(self.number, "ABORTED", result)

    def canceled(self, result: Any = None) -> bool:
        """Ends the goal as CANCELED, with a result or without."""
        return self._server._end(self.number, "CANCELED", result)

    def reject(self) -> bool:
        """Ends the goal as REJECTED."""
        return self._server._end(self.number, "REJECTED", None)


class ActionServer(Closable, Generic[Goal]):
    """Serves one action, one goal at a time. Not for two threads at a time; forked children open their own."""

    command_subscriber: type[Subscriber[Any]]
    progress_publisher: type[Publisher[Any]]
    outcome_publisher: type[Publisher[Any]]

    def __init__(
        self,
        action: str,
        *,
        lock_timeout: float | None = None,
        mode: int | None = None,
        group: str | int | None = None,
    ) -> None:
        """Opens the action's regions or creates them; parameters, errors and stale goals as for a ServiceServer."""
        options: dict[str, Any] = {"lock_timeout": lock_timeout, "mode": mode, "group": group}
        with ExitStack() as opened:
            requests = opened.enter_context(self.command_subscriber(f"{action}-goal", **options))
            skip_stale(requests)
            self._progress = opened.enter_context(self.progress_publisher(f"{action}-feedback", **options))
            responses = opened.enter_context(self.outcome_publisher(f"{action}-result", **options))
            if self._progress._end.doubtful or responses._end.doubtful:
                skip_stale(requests)
            opened.pop_all()
        self._calls = CallServer(requests, responses)
        self._kinds: Any = self.progress_publisher.message_type, self.outcome_publisher.message_type
        self._waiting: ServedGoal[Goal] | None = None
        self._is_unwanted = False
        self._action = action

    def serve(self, handler: Callable[[ServedGoal[Goal]], None], timeout: float | None = None) -> None:
        """Accepts each goal and calls `handler(goal)`, which ends it: goal.succeed, goal.abort or goal.canceled.

        Ends after `timeout` seconds, or never. A goal that the handler leaves without an end is ABORTED; so is one in
        which it raises an exception, which is logged as `shmgen`; another BaseException ends serve(). A lock timeout
        does not: the outcome then waits until the lock is free or a newer goal has arrived.
        """
        deadline = deadline_of(timeout)
        for goal in until(deadline, self.wait):
            try:
                self._calls.retry_until_sent(goal.accept, deadline)
                handler(goal)
            except Exception:
                log_exception(f"{self._action}: goal {goal.number} aborted")
            except BaseException:
                with suppress(LockTimeout):
                    goal.abort()
                raise
            self._calls.retry_until_sent(goal.abort, deadline)

    def take(self) -> ServedGoal[Goal] | None:
        """The newest goal not taken yet, or None. The client has abandoned the one before it, if that has not ended."""
        return self.wait(0.0)

    def wait(self, timeout: float) -> ServedGoal[Goal] | None:
        """The newest goal as soon as there is one, or None after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while True:
            left = max(0.0, deadline - time.monotonic())
            self._look(0.0 if self._waiting else left)
            if self._waiting or not left:
                break
        goal, self._waiting = self._waiting, None
        return goal

    def client_lives(self) -> bool:
        """Whether there is a client now; that a PLC has stopped is known a second later. Call it often."""
        return self._calls.client_lives()

    def close(self) -> None:
        """Releases the action for another server; the regions stay."""
        self._calls.close()
        self._progress.close()

    @property
    def action(self) -> str:
        """As given."""
        return self._action

    def _look(self, timeout: float = 0.0) -> None:
        """Takes one command. The number of the callee is that of the newest goal known."""
        taken = self._calls.take(timeout)
        if taken is None:
            return
        number, command = taken
        if not command.cancel:
            self._calls.begin(number)
            self._is_unwanted = False
            usable = self._calls.is_usable(command, partial(self._end, number, "REJECTED", None))
            self._waiting = ServedGoal(self, number, command.goal) if usable else None
        elif command.cancel == self._calls.number and not self._waiting:
            self._is_unwanted = True
        else:  # nobody has taken that goal: it waits here, or its cancel has overwritten it
            self._calls.begin(command.cancel)
            self._waiting = None
            self._calls.retry_until_sent(
                partial(self._end, command.cancel, "CANCELED", None), deadline_of(UNTIL_RECOVERED)
            )

    def _unwanted(self, number: int) -> bool:
        self._look()
        return self._is_unwanted or not self._calls.awaits(number)

    def _accept(self, number: int) -> bool:
        progress, _ = self._kinds
        return self._publish(number, progress(goal=number, status=progress.ACCEPTED))

    def _publish_feedback(self, number: int, feedback: Any) -> bool:
        progress, _ = self._kinds
        status = progress.CANCELING if self._is_unwanted else progress.EXECUTING
        return self._publish(number, SimpleNamespace(goal=number, status=status, feedback=feedback))

    def _publish(self, number: int, progress: Any) -> bool:
        if not self._calls.awaits(number):
            return False
        self._progress.publish(progress)
        return True

    def _end(self, number: int, status: str, result: Any) -> bool:
        _, outcome = self._kinds
        value = getattr(outcome, status)
        if result is None:
            return self._calls.send_response(number, outcome(goal=number, status=value))
        return self._calls.send_response(number, SimpleNamespace(goal=number, status=value, result=result))
