"""Turns the samples of a region into messages of its ROS topic."""

from __future__ import annotations

import struct
import threading
import time
from contextlib import suppress
from typing import Any

from shmgen.bridge import plan
from shmgen.bridge.backend import Backend
from shmgen.bridge.counters import Counters
from shmgen.bridge.endpoint import ReopeningEndpoint
from shmgen.bridge.listener import Listener
from shmgen.bridge.plan import Route
from shmgen.live.classes import subscriber
from shmgen.runtime import Message, ShmError, Subscriber, ValueRejected
from shmgen.runtime.messages.values import set_clock


class FromPlc:
    """A Side: what the PLC writes goes to ROS, by a thread that sleeps until it does.

    It shares `listener` with others; without one, and with a `rate`, for which it waits itself, it has its own.
    """

    def __init__(
        self, route: Route, counters: Counters, stopping: threading.Event, listener: Listener | None = None
    ) -> None:
        self.route = route
        self.about = route.about
        self.counters = counters
        self._stopping = stopping
        self._missed = 0
        self._stale = False
        self._due = 0.0
        self._is_first = True
        self.end = ReopeningEndpoint(self._opened, counters, stopping)
        self.end.silence = self._silence
        self._listener = listener if listener and not route.topic.carried.rate else Listener(stopping)

    def join(self, backend: Backend) -> None:
        self._outlet, self._now = backend.publisher(self.route.wire), backend.now
        self._message = self._outlet.new()
        plan.check(self.route, self._message)
        self._listener.add(self)

    def beat(self) -> None:
        """Looks whether the PLC lives; the end itself is the listener's."""
        limit = self.route.topic.carried.stale
        reader = self.end.now
        if limit is not None and reader is not None:
            with suppress(ShmError, ValueError):  # closed meanwhile
                self._stale = reader.is_stale(limit)

    def _silence(self) -> str:
        return (
            f"the PLC's heartbeat stands still for {self.route.topic.carried.stale:g} s or more" if self._stale else ""
        )

    def leave(self) -> None:
        self._listener.forget(self)

    def close(self) -> None:
        if self._listener.forget(self):
            self.end.close()

    def renewed(self) -> Subscriber[Message] | None:
        return self.end.look(self.take)

    def take(self, reader: Subscriber[Message]) -> bool:
        rate = self.route.topic.carried.rate
        if rate:
            if self._stopping.wait(max(0.0, self._due - time.monotonic())):
                return True
            self._due = time.monotonic() + 1 / rate
            samples = [sample] if (sample := reader.read()) else []
        else:
            samples = reader.read_all()
        for sample in samples:
            self._send(sample)
        self._count(reader)
        return bool(samples)

    def _send(self, sample: Message) -> None:
        self.counters.came()
        try:
            if self._outlet.send_payload is not None:
                with suppress(ValueRejected, struct.error):  # the long way says what is wrong with it
                    self._outlet.send_payload(bytes(sample))
                    self.counters.passed += 1
                    return
            message = self._outlet.new() if self._outlet.keeps else self._message
            self.route.kind._decode(bytes(sample), 0, message)
            if self.route.topic.carried.stamp == "now":
                self._stamp(message)
            self._outlet.send(message)
            self.counters.passed += 1
        except ValueRejected as error:
            self.counters.reject(str(error))
        except Exception as error:  # whatever a ROS may raise: one message is not worth the bridge
            self.counters.reject(f"{type(error).__name__}: {error}", " by ROS")

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

    def _count(self, reader: Subscriber[Message]) -> None:
        missed = reader.missed - self._missed
        self._missed += missed
        if self.route.topic.carried.rate:
            self.counters.thinned += missed
        else:
            self.counters.missed += missed

    def _opened(self) -> Subscriber[Message]:
        topic = self.route.topic
        # What lies in a second region was all written since the one before was removed.
        made = subscriber(self.route.kind, topic.topic, topic.depth, history=not self._is_first)
        if self._is_first and not topic.carried.latch:
            # As in ROS: who comes later does not hear what was said before, least of all a command of yesterday.
            made.read()
        self._missed, self._is_first = made.missed, False
        return made
