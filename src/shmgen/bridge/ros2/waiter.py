"""A thread that takes what comes to something of a node, one message after another, in order.

rclpy's executors make a wait set of all that a node has for every message, and give one at a time; so a topic waits
for others, and behind its own queue. Here each has a wait set of its own, as in rclpy.wait_for_message.
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
"""Subscriptions, guards, timers, clients, services; its events come behind."""
_LONGEST = 10**9
"""Nanoseconds after which it looks even if nothing has come."""


class Ours(CallbackGroup):  # type: ignore[misc, unused-ignore]
    """What an executor is never to touch."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing has begun."""


class Waiter:
    """Calls `take` in a thread of its own whenever there is something, and each second; it has to take all there is.

    Events of a subscription are handled here, before: with Fast DDS each message wakes who waits for them, and an
    executor that did would take more time than all else.
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
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Tells it to end."""
        self._ended = True
        self._closing.trigger()

    def join(self, seconds: float) -> bool:
        """Whether it has ended."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

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
            return  # destroyed
