"""The server of an action: receives goals and cancel requests through shared memory, and sends their outcomes."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from types import SimpleNamespace
from typing import Any, Generic, TypeVar

from shmgen.runtime.calls import HEARTBEAT_INTERVAL, CallServer, deadline_of, log_exception, until
from shmgen.runtime.errors import LockTimeout
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.resource import CallEnd, OpenRegion
from shmgen.runtime.region.settings import UNTIL_RECOVERED
from shmgen.runtime.subscriber import Subscriber

Goal = TypeVar("Goal", bound=Message)


class ServedGoal(Generic[Goal]):
    """A goal that an action server is executing. The method names are those of rclpy's goal handle.

    After the goal has ended, or after a newer goal has arrived, the methods send nothing and return False.
    The methods raise ValueRejected if a value does not fit. They raise LockTimeout if this machine needs the lock
    (not x86) and the lock is not free in time.

    ```python
    with FibonacciActionServer("/fibonacci") as server:
        if goal := server.wait(timeout=1.0):
            goal.succeed(Fibonacci_Result(sequence=[0, 1, 1]))
    ```
    """

    def __init__(self, server: ActionServer[Goal], number: int, request: Goal) -> None:
        self.number = number
        self.request = request
        self._server = server

    @property
    def is_cancel_requested(self) -> bool:
        """True if the client has requested a cancel or sent a newer goal, or if the goal has ended.

        Read this property often: each read sends the server's heartbeat.
        """
        self._server._look()
        return self._server._is_unwanted or not self.is_awaited

    @property
    def is_awaited(self) -> bool:
        """True until the goal has ended or a newer goal has arrived."""
        return self._server._calls.awaits(self.number)

    def accept(self) -> bool:
        """Report to the client that the server has accepted the goal.

        Return False, without sending, if the goal has already ended or a newer goal has arrived.
        """
        progress = self._server.progress_publisher.message_type
        return self._server._publish(self.number, progress(goal=self.number, status=progress.ACCEPTED))

    def publish_feedback(self, feedback: Any) -> bool:
        """Publish `feedback`: a feedback message of the action, or any object with the same attributes.

        Return False, without sending, if the goal has already ended or a newer goal has arrived.
        """
        progress = self._server.progress_publisher.message_type
        status = progress.CANCELING if self._server._is_unwanted else progress.EXECUTING
        return self._server._publish(self.number, SimpleNamespace(goal=self.number, status=status, feedback=feedback))

    def succeed(self, result: Any) -> bool:
        """End the goal as SUCCEEDED. Return False if the goal has already ended or a newer goal has arrived."""
        return self._server._end(self.number, "SUCCEEDED", result)

    def abort(self, result: Any = None) -> bool:
        """End the goal as ABORTED, with or without a result.

        Return False, without sending, if the goal has already ended or a newer goal has arrived.
        """
        return self._server._end(self.number, "ABORTED", result)

    def canceled(self, result: Any = None) -> bool:
        """End the goal as CANCELED, with or without a result.

        Return False, without sending, if the goal has already ended or a newer goal has arrived.
        """
        return self._server._end(self.number, "CANCELED", result)

    def reject(self) -> bool:
        """End the goal as REJECTED. Return False if the goal has already ended or a newer goal has arrived."""
        return self._server._end(self.number, "REJECTED", None)


class ActionServer(CallEnd, Generic[Goal]):
    """Serve one action, one goal at a time.

    Only one thread at a time may use a server. A forked child must open its own server.

    ```python
    def compute(goal):
        goal.publish_feedback(Fibonacci_Feedback(sequence=[0, 1]))
        goal.succeed(Fibonacci_Result(sequence=[0, 1, 1]))

    with FibonacciActionServer("/fibonacci") as server:
        server.serve(compute, timeout=1.0)
    ```
    """

    command_subscriber: type[Subscriber[Any]]
    progress_publisher: type[Publisher[Any]]
    outcome_publisher: type[Publisher[Any]]
    _calls: CallServer[Any, Any]

    def _open(self, write: OpenRegion, read: OpenRegion) -> None:
        requests = read(self.command_subscriber, "goal")
        requests.engine_end.skip()
        self._progress = write(self.progress_publisher, "feedback")
        responses = write(self.outcome_publisher, "result")
        self._calls = CallServer(requests, responses, self._progress)
        self._waiting: ServedGoal[Goal] | None = None
        self._is_unwanted = False

    def serve(self, handler: Callable[[ServedGoal[Goal]], None], timeout: float | None = None) -> None:
        """Accept each goal and call `handler(goal)`. The handler calls goal.succeed, goal.abort or goal.canceled.

        Return after `timeout` seconds, or when another thread or a signal handler closes the server.
        If the handler returns without ending the goal, the goal is ABORTED. If the handler raises an exception, the
        goal is ABORTED and the exception is logged by the logger `shmgen`. KeyboardInterrupt and any other
        BaseException end serve().
        If a lock timeout prevents accepting or aborting a goal, serve() continues. The server retries until the lock is
        free, `timeout` ends, or a newer goal arrives.
        """
        deadline = deadline_of(timeout)
        for goal in until(deadline, self.wait):
            try:
                self._calls.retry_until_sent(goal.accept, deadline)
                handler(goal)
            except Exception:
                log_exception(f"{self._name}: goal {goal.number} aborted")
            except BaseException:
                with suppress(LockTimeout):
                    goal.abort()
                raise
            self._calls.retry_until_sent(goal.abort, deadline)

    def take(self) -> ServedGoal[Goal] | None:
        """Return the newest goal that no call has returned yet, or None. Do not wait.

        A new goal replaces the previous goal.
        """
        return self.wait(0.0)

    def wait(self, timeout: float) -> ServedGoal[Goal] | None:
        """Return the newest goal as soon as a new goal arrives, or None after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while True:
            left = max(0.0, deadline - time.monotonic())
            self._look(0.0 if self._waiting else left)
            if self._waiting or not left:
                break
        goal, self._waiting = self._waiting, None
        return goal

    async def wait_async(self, timeout: float) -> ServedGoal[Goal] | None:
        """Return the newest goal as soon as a new goal arrives, or None after `timeout` seconds. For coroutines."""
        return await self._calls.incoming._poll_until_found(self.take, timeout, HEARTBEAT_INTERVAL)

    def client_lives(self) -> bool:
        """Return True if a client is running. Call this method often.

        A stopped PLC client is recognized after 1 s without a heartbeat.
        """
        return self._calls.client_lives()

    @property
    def action(self) -> str:
        """The name of the action."""
        return self._name

    def _look(self, timeout: float = 0.0) -> None:
        """Wait at most `timeout` seconds for a command of the client to start or cancel a goal, and obey the command.

        A new goal is stored in `_waiting`, and its number in `_calls.number`.
        """
        request = self._calls.take(timeout)
        if request is None:
            return
        number, command = request
        if not command.cancel:
            self._calls.begin(number)
            self._is_unwanted = False
            usable = self._calls.is_usable(command, partial(self._end, number, "REJECTED", None))
            self._waiting = ServedGoal(self, number, command.goal) if usable else None
        elif command.cancel == self._calls.number and not self._waiting:
            self._is_unwanted = True
        else:  # the goal was not taken yet: it is in `_waiting`, or its cancel request has overwritten it
            self._calls.begin(command.cancel)
            self._waiting = None
            self._calls.retry_until_sent(
                partial(self._end, command.cancel, "CANCELED", None), deadline_of(UNTIL_RECOVERED)
            )

    def _publish(self, number: int, progress: Any) -> bool:
        if not self._calls.awaits(number):
            return False
        self._progress.publish(progress)
        return True

    def _end(self, number: int, status: str, result: Any) -> bool:
        outcome: Any = self.outcome_publisher.message_type
        value = getattr(outcome, status)
        if result is None:
            return self._calls.send_response(number, outcome(goal=number, status=value))
        return self._calls.send_response(number, SimpleNamespace(goal=number, status=value, result=result))
