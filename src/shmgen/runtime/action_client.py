"""The client of an action: goals are commands in shared memory, answered by feedback and results."""

from __future__ import annotations

import time
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any, Generic, TypeVar

from shmgen.runtime.calls import CallClient
from shmgen.runtime.errors import CallTimeout, NoServer
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.resource import Closable
from shmgen.runtime.subscriber import Subscriber

Goal = TypeVar("Goal", bound=Message)
Feedback = TypeVar("Feedback", bound=Message)
Outcome = TypeVar("Outcome", bound=Message)


class ActionClient(Closable, Generic[Goal, Feedback, Outcome]):
    """Sends goals to one action, one at a time. Not for two threads at a time; forked children open their own."""

    command_publisher: type[Publisher[Any]]
    progress_subscriber: type[Subscriber[Any]]
    outcome_subscriber: type[Subscriber[Outcome]]

    def __init__(
        self,
        action: str,
        *,
        lock_timeout: float | None = None,
        mode: int | None = None,
        group: str | int | None = None,
    ) -> None:
        """Opens the action's regions or creates them; parameters and errors as for a ServiceClient."""
        options: dict[str, Any] = {"lock_timeout": lock_timeout, "mode": mode, "group": group}
        with ExitStack() as opened:
            requests = opened.enter_context(self.command_publisher(f"{action}-goal", **options))
            responses = opened.enter_context(self.outcome_subscriber(f"{action}-result", **options))
            self._progress = opened.enter_context(self.progress_subscriber(f"{action}-feedback", **options))
            opened.pop_all()
        self._command: Any = self.command_publisher.message_type
        self._calls: CallClient[Any, Outcome] = CallClient(requests, responses, "goal")
        self._action = action
        self._goal = 0
        self._status = 0
        self._feedback: Feedback | None = None

    def send_goal(self, goal: Any, timeout: float) -> int:
        """Waits `timeout` seconds for a server, sends `goal` (any object with its attributes), returns its number.

        A goal that still runs is abandoned: the newer one makes the server cancel it. Raises NoServer, and
        nothing was sent; ValueRejected; LockTimeout.
        """
        deadline = time.monotonic() + timeout
        if not self._calls.wait_for_server(timeout):
            raise NoServer(f"{self._action}: no server within {timeout:g} s; the request was not sent")
        self._status, self._feedback = 0, None
        self._goal = self._calls.send_request(SimpleNamespace(cancel=0, goal=goal), deadline)
        return self._goal

    def feedback(self) -> Feedback | None:
        """The newest feedback on the goal, also after its end, or None if it has been read already."""
        self._look()
        feedback, self._feedback = self._feedback, None
        return feedback

    @property
    def status(self) -> int:
        """ACCEPTED, EXECUTING or CANCELING of the progress, as of action_msgs/GoalStatus; 0 = not accepted yet."""
        self._look()
        return self._status

    def poll(self) -> Outcome | None:
        """How the goal ended, once, or None if it has not yet: `status` and `result`."""
        return self._calls.poll()

    def result(self, timeout: float) -> Outcome:
        """Waits for the end of the goal. Raises CallTimeout after `timeout` seconds; the goal then continues."""
        number = self._calls.number
        if not number:
            raise CallTimeout(f"{self._action}: no goal is under way")
        outcome = self._calls.wait(timeout)
        if outcome is None:
            raise CallTimeout(f"{self._action}: goal {number} has not ended within {timeout:g} s")
        return outcome

    def cancel(self) -> None:
        """Requests that the server cancel the goal; result() then returns how it ended. Does nothing without a goal."""
        if self._calls.number:
            self._calls.tell(self._command(cancel=self._calls.number))

    def cancel_former(self) -> None:
        """Requests that the server cancel the goal of a former client, if that goal has not ended."""
        progress = self._progress.read()
        if progress is not None and not self._calls.number:
            self._calls.tell(self._command(cancel=progress.goal))

    def server_is_ready(self) -> bool:
        """Whether a server is available now. Takes up to a second where a PLC was the server and may have stopped."""
        return self._calls.server_is_ready()

    def wait_for_server(self, timeout: float) -> bool:
        """Whether a server is available, as soon as one is or after `timeout` seconds."""
        return self._calls.wait_for_server(timeout)

    def close(self) -> None:
        """Releases the action for another client; the regions stay, and a running goal continues."""
        self._calls.close()
        self._progress.close()

    @property
    def action(self) -> str:
        """As given."""
        return self._action

    def _look(self) -> None:
        """Takes the newest progress over if it is the goal's."""
        progress = self._progress.read()
        if progress is not None and self._goal and progress.goal == self._goal:
            self._status = progress.status
            if progress.status != progress.ACCEPTED:
                self._feedback = progress.feedback
