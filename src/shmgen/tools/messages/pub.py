"""Publishes a person's values, once or at a rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import suppress
from typing import Any

from shmgen.live.classes import ClassRegistry, publisher
from shmgen.live.regions import View, depth_of
from shmgen.runtime import Message, region_name
from shmgen.runtime.errors import RegionMissing
from shmgen.tools.messages import parse

HEARTBEAT = 0.05
"""Seconds between two signs of life while there is nothing to publish."""


def publish(
    topic: str, request: str, data: Any, registry: ClassRegistry, rate: float, count: int | None
) -> Generator[Message, None, None]:
    """Publishes `rate` times a second, `count` times or without end, and yields each sample published.

    The depth is that of the region that is there, else that of [[topics]], else 1. Raises Rejected, ValueRejected
    and ValueError before the region is touched, and what a Publisher raises.
    """
    digest, depth = _expected(topic, request, registry)
    kind = registry.message(request, digest)
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
            due = max(due + 1 / rate, time.monotonic())  # after a pause no burst
            _sleep_until(due, writer.heartbeat)
            message = parse.build(kind, data)  # anew: a stamp may be `now`


def _expected(topic: str, request: str, registry: ClassRegistry) -> tuple[int | None, int]:
    """The digest wanted, if the region holds that type, and the depth."""
    with suppress(RegionMissing), View(region_name(topic)) as view:
        header = view.header()
        package, _, bare = header.type_name.partition("/")
        same = request in (header.type_name, f"{package}/{bare.rpartition('/')[2]}")
        if same:
            return header.digest, depth_of(header)
    return None, registry.depth_of(topic)


def _sleep_until(due: float, heartbeat: Callable[[], None]) -> None:
    while (left := due - time.monotonic()) > 0:
        time.sleep(min(left, HEARTBEAT))
        if left > HEARTBEAT:
            heartbeat()
