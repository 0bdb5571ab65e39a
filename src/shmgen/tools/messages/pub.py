"""Publishes values that a user types, once or repeatedly."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any

from shmgen.live.classes import ClassRegistry, publisher
from shmgen.runtime import Message
from shmgen.tools.messages import parse

HEARTBEAT = 0.05
"""Seconds between two heartbeats while no sample is due."""


def publish(
    topic: str, request: str, data: Any, registry: ClassRegistry, rate: float, count: int | None
) -> Generator[Message, None, None]:
    """Publish the values in `data`, `rate` times a second. Yield each published message. Stop after `count`, if given.

    The depth is the depth of the existing region, else the depth in [[topics]], else 1. Before the region is opened,
    raises ValueRejected or ValueError for invalid data, or an error of ClassRegistry. Then raises errors of Publisher.
    """
    kind, depth = registry.message_of_topic(topic, request)
    message = parse.build(kind, data)
    with publisher(kind, topic, depth) as writer:
        due = time.monotonic()
        number = 0
        while True:
            writer.publish(message)
            yield message
            number += 1
            if number == count:
                return
            due = max(due + 1 / rate, time.monotonic())  # no burst after a pause
            _sleep_until(due, writer.heartbeat)
            message = parse.build(kind, data)  # build again, because a stamp may be `now`


def _sleep_until(due: float, heartbeat: Callable[[], None]) -> None:
    while (left := due - time.monotonic()) > 0:
        time.sleep(min(left, HEARTBEAT))
        if left > HEARTBEAT:
            heartbeat()
