"""Turns the samples of a region into messages of its ROS topic."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from typing import Any

from shmgen.bridge import plan
from shmgen.bridge.backend import Backend
from shmgen.bridge.counters import Counters
from shmgen.bridge.plan import Route
from shmgen.live.classes import subscriber
from shmgen.live.regions import View
from shmgen.runtime import Message, ShmError, Subscriber, ValueRejected, region_name
from shmgen.runtime.values import set_clock

_LOOK = 0.1
"""Seconds after which a thread that waits for a sample looks whether the bridge is to stop."""
_AGAIN = 0.5
"""Seconds until a region that could not be opened is tried again."""


class FromPlc:
    """A Side: a thread for each topic, asleep until the PLC wakes it."""

    def __init__(self, route: Route, counters: Counters, stopping: threading.Event) -> None:
        self.route = route
        self.about = plan.about(route)
        self.counters = counters
        self._stopping = stopping
        self._subscriber: Subscriber[Message] | None = None
        self._missed = 0
        self._stale = False
        self._open()
        if not route.topic.carried.latch:
            # As in ROS: who comes later does not hear what was said before, least of all a command of yesterday.
            self._reader.read()

    def join(self, backend: Backend) -> None:
        self._outlet, self._now = backend.publisher(self.route.wire), backend.now
        plan.check(self.route, self._outlet.new())
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def tick(self) -> None:
        limit = self.route.topic.carried.stale
        reader = self._subscriber
        if limit is not None and reader is not None:
            with suppress(ValueError):  # closed meanwhile
                self._stale = reader.is_stale(limit)

    def silence(self) -> str:
        return (
            f"the PLC's heartbeat stands still for {self.route.topic.carried.stale:g} s or more" if self._stale else ""
        )

    @property
    def is_open(self) -> bool:
        return self._subscriber is not None

    @property
    def lock_misses(self) -> int:
        return self._subscriber.lock_misses if self._subscriber else 0

    def close(self) -> None:
        with suppress(AttributeError):  # never started
            self._thread.join(2 * _LOOK)
            if self._thread.is_alive():
                return
        self._close()

    @property
    def _reader(self) -> Subscriber[Message]:
        assert self._subscriber is not None
        return self._subscriber

    def _run(self) -> None:
        period = 1 / self.route.topic.carried.rate if self.route.topic.carried.rate else None
        due = 0.0
        while not self._stopping.wait(max(0.0, due - time.monotonic()) if period else 0):
            try:
                if self._subscriber is None or self._view.removed:
                    self._close()
                    self._open()
                if not self._reader.ready(_LOOK):
                    continue
                if period:
                    due = time.monotonic() + period
                    samples = [sample] if (sample := self._reader.read()) else []
                else:
                    samples = self._reader.read_all()
                for sample in samples:
                    self._send(sample)
                self._count()
                if not samples:  # locked out: try again, but not at once
                    self._stopping.wait(0.001)
            except (ShmError, OSError) as error:
                self.counters.complain(str(error))
                self._stopping.wait(_AGAIN)

    def _send(self, sample: Message) -> None:
        counters = self.counters
        counters.came()
        try:
            message = self._outlet.new()
            self.route.kind._decode(bytes(sample), 0, message)
            if self.route.topic.carried.stamp == "now":
                self._stamp(message)
            self._outlet.send(message)
            counters.passed += 1
        except ValueRejected as error:
            counters.rejected += 1
            counters.complain(f"rejected: {error}")
        except Exception as error:  # whatever a ROS may raise: one message is not worth the bridge
            counters.rejected += 1
            counters.complain(f"rejected by ROS: {type(error).__name__}: {error}")

    def _stamp(self, message: Any) -> None:
        """A PLC seldom knows the time of day; ROS takes a stamp of zero for an age of half a century."""
        *owners, name = self.route.stamp or ("",)
        if not name:
            return
        for owner in owners:
            message = getattr(message, owner)
        stamp = getattr(message, name)
        if not any(getattr(stamp, part, 0) for part in ("sec", "nanosec", "secs", "nsecs")):
            setattr(message, name, set_clock(stamp, self._now()))

    def _count(self) -> None:
        missed = self._reader.missed - self._missed
        self._missed += missed
        if self.route.topic.carried.rate:
            self.counters.thinned += missed
        else:
            self.counters.missed += missed

    def _open(self) -> None:
        topic = self.route.topic
        self._subscriber = subscriber(self.route.kind, topic.topic, topic.depth)
        self._view = View(region_name(topic.topic))
        self._missed = 0

    def _close(self) -> None:
        if self._subscriber:
            self._subscriber.close()
            self._subscriber = None
            self._view.close()
