"""A thread that takes the messages of one subscription or service, in order.

For every message, rclpy's executors build a wait set of all entities of the node and take one message. Here each entity
has its own wait set, as in rclpy.wait_for_message, so that no topic delays another topic.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Literal

from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation

_COUNTS = {"subscription": (1, 1, 0, 0, 0), "service": (0, 1, 0, 0, 1)}
"""Sizes of the wait set: subscriptions, guard conditions, timers, clients, services. The event count follows."""
_LONGEST = 10**9
"""Maximum nanoseconds between two calls of `take`."""


class Ours(CallbackGroup):  # type: ignore[misc, unused-ignore]
    """A callback group that no executor executes. Its entities belong to the bridge's own threads."""

    def can_execute(self, entity: Any) -> bool:
        """Return False, so that executors leave the entity to the bridge's thread."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return False, so that an executor that has already selected the entity does not execute it."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing, because no execution has begun."""


class Waiter:
    """A thread that calls `take` when data arrives, and at least once a second. `take` must take all waiting messages.

    The thread also handles the events of a subscription, because with Fast DDS each message wakes the thread that waits
    for events. To wake rclpy's executor as well for each message would cost more time than all other work.
    """

    def __init__(
        self, entity: Any, kind: Literal["subscription", "service"], take: Callable[[], None], context: Any, name: str
    ) -> None:
        self._entity = entity
        self._kind = kind
        self._events = list(getattr(entity, "event_handlers", ()))
        self._take = take
        self._closing = GuardCondition(None, None, context=context)
        self._waiting = rclpy_implementation.WaitSet(*_COUNTS[kind], len(self._events), context.handle)
        self._ended = False
        self.thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.thread.start()

    def close(self) -> None:
        """Make the thread end, without waiting for the end."""
        self._ended = True
        self._closing.trigger()

    def _run(self) -> None:
        waiting, add = self._waiting, getattr(self._waiting, f"add_{self._kind}")
        try:
            while not self._ended:
                waiting.clear_entities()
                add(self._entity.handle)
                waiting.add_guard_condition(self._closing.handle)
                for event in self._events:
                    event.add_to_wait_set(waiting)
                waiting.wait(_LONGEST)
                if self._ended:
                    return
                for event in self._events:
                    if event.is_ready(waiting):
                        event.callback(event.take_data())
                self._take()
        except InvalidHandle:
            return  # the entity was destroyed
