"""The client of an action: sends goals through shared memory and receives feedback and results."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any, Generic, TypeVar

from shmgen.runtime.calls import CallClient
from shmgen.runtime.errors import CallTimeout, NoServer
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.resource import CallEnd, OpenRegion
from shmgen.runtime.subscriber import Subscriber

Goal = TypeVar("Goal", bound=Message)
Feedback = TypeVar("Feedback", bound=Message)
Outcome = TypeVar("Outcome", bound=Message)


class ActionClient(CallEnd, Generic[Goal, Feedback, Outcome]):
    """Send goals to one action, one goal at a time.

    Only one thread at a time may use a client. A forked child must open its own client.

    ```python
    with FibonacciActionClient("/fibonacci") as client:
        client.send_goal(Fibonacci_Goal(order=3), timeout=1.0)
        print(list(client.result(timeout=10.0).result.sequence))
    ```
    """

    command_publisher: type[Publisher[Any]]
    progress_subscriber: type[Subscriber[Any]]
    outcome_subscriber: type[Subscriber[Outcome]]
    _calls: CallClient[Any, Outcome]

    def _open(self, write: OpenRegion, read: OpenRegion) -> None:
        self._commands = write(self.command_publisher, "goal")
        responses = read(self.outcome_subscriber, "result")
        self._progress = read(self.progress_subscriber, "feedback")
        self._calls = CallClient(self._commands, responses, "goal")
        self._command: Any = self.command_publisher.message_type
        self._goal = 0
        self._status = 0
        self._feedback: Feedback | None = None

    def send_goal(self, goal: Any, timeout: float) -> int:
        """Wait at most `timeout` seconds for a server, send `goal` and return the number of the goal.

        `goal` is a goal message, or any object with the same attributes. The new goal makes the server cancel a goal
        that is still running. Raises NoServer if no server is available; nothing was sent.
        Raises ValueRejected if a value does not fit.
        Raises LockTimeout if this machine needs the lock (not x86) and the lock is not free in time.
        """
        deadline = time.monotonic() + timeout
        if not self._calls.wait_for_server(timeout):
            raise NoServer(f"{self._name}: no server within {timeout:g} s; the request was not sent")
        self._status, self._feedback = 0, None
        self._goal = self._calls.send_request(SimpleNamespace(cancel=0, goal=goal), deadline)
        return self._goal

    def feedback(self) -> Feedback | None:
        """Return the newest feedback on the goal, or None if no new feedback has arrived since the last call.

        Feedback can still be read after the goal has ended.
        """
        self._look()
        feedback, self._feedback = self._feedback, None
        return feedback

    @property
    def status(self) -> int:
        """The status of the goal: ACCEPTED, EXECUTING or CANCELING, or 0 before the server accepts the goal.

        The values are those of action_msgs/GoalStatus.
        """
        self._look()
        return self._status

    def poll(self) -> Outcome | None:
        """Return the outcome of the goal (`status` and `result`), or None if the goal has not ended. Do not wait.

        The outcome is returned once: the next call returns None.
        """
        return self._calls.poll()

    def result(self, timeout: float) -> Outcome:
        """Wait for the end of the goal and return its outcome: `status` and `result`.

        Raises CallTimeout if the goal has not ended after `timeout` seconds; the goal then continues.
        Raises CallTimeout if no goal is running.
        """
        number = self._calls.number
        if not number:
            raise CallTimeout(f"{self._name}: no goal is running")
        outcome = self._calls.wait(timeout)
        if outcome is None:
            raise CallTimeout(f"{self._name}: goal {number} has not ended within {timeout:g} s")
        return outcome

    async def wait_async(self, timeout: float) -> Outcome | None:
        """Return the outcome of the goal as soon as the goal ends, or None after `timeout` seconds. For coroutines.

        After a timeout the goal continues.
        """
        return await self._calls.incoming._poll_until_found(self.poll, timeout)

    def cancel(self) -> None:
        """Request that the server cancel the goal. result() then returns the outcome.

        Do nothing if no goal is running.
        """
        if self._calls.number:
            self._commands.publish(self._command(cancel=self._calls.number))

    def cancel_former(self) -> None:
        """Request that the server cancel the goal of a previous client.

        Do nothing if this client has a running goal, or if the server has published no progress.
        """
        progress = self._progress.read()
        if progress is not None and not self._calls.number:
            self._commands.publish(self._command(cancel=progress.goal))

    def server_is_ready(self) -> bool:
        """Return True if a server is available now. The call takes up to 1 s if the last known server was a PLC."""
        return self._calls.server_is_ready()

    def wait_for_server(self, timeout: float) -> bool:
        """Return True as soon as a server is available, or False after `timeout` seconds."""
        return self._calls.wait_for_server(timeout)

    @property
    def action(self) -> str:
        """The name of the action."""
        return self._name

    def _look(self) -> None:
        """Update status and feedback from the newest progress message if that message belongs to the current goal."""
        progress = self._progress.read()
        if progress is not None and self._goal and progress.goal == self._goal:
            self._status = progress.status
            if progress.status != progress.ACCEPTED:
                self._feedback = progress.feedback
