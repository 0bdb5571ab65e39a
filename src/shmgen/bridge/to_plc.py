"""Turns the messages of a ROS topic into samples of its region."""

from __future__ import annotations

import threading
import time
from typing import Any

from shmgen.bridge import plan
from shmgen.bridge.backend import Backend
from shmgen.bridge.codec.cut import cut
from shmgen.bridge.counters import Counters
from shmgen.bridge.endpoint import ReopeningEndpoint
from shmgen.bridge.plan import Route
from shmgen.live.classes import publisher
from shmgen.runtime import CountExceeded, Message, Publisher, ShmError, StringTooLong, ValueRejected


class ToPlc:
    """A Side, and a MessageSink: what its backend could not hand over is counted."""

    def __init__(self, route: Route, counters: Counters, stopping: threading.Event) -> None:
        self.route = route
        self.about = route.about
        self.counters = counters
        self.reject, self.refuse = counters.reject, counters.refuse
        self.meet, self.lose = counters.meet, counters.lose
        self._stopping = stopping
        self._waiting: Any = None
        self._came = threading.Event()
        topic = route.topic
        self.end = ReopeningEndpoint(lambda: publisher(route.kind, topic.topic, topic.depth), counters, stopping)
        self.end.silence, self.close = self._silence, self.end.close

    def join(self, backend: Backend) -> None:
        if self.route.topic.carried.rate:
            threading.Thread(target=self._paced, args=(1 / self.route.topic.carried.rate,), daemon=True).start()
        plan.check(self.route, backend.subscribe(self.route.wire, self).new())

    def take(self, message: Any) -> None:
        """From any thread."""
        self.counters.came()
        with self.end.lock:
            if self.route.topic.carried.rate is None:
                self._publish(message)
                return
            self.counters.thinned += self._waiting is not None
            self._waiting = message
        self._came.set()

    def beat(self) -> None:
        """Shows the PLC that the bridge lives, unless ROS has fallen silent for longer than `stale`."""
        self.end.beat(id if self._silence() else Publisher.heartbeat)

    def _silence(self) -> str:
        limit = self.route.topic.carried.stale
        age = self.counters.age
        if limit is None or (age is not None and age <= limit):
            return ""
        return f"no message from ROS for {limit:g} s or more"

    def leave(self) -> None:
        """What waits for its turn has lost it."""
        with self.end.lock:
            self.counters.thinned += self._waiting is not None
            self._waiting = None

    def _paced(self, period: float) -> None:
        """The newest message when its turn comes, so that the last of a burst is not lost for ever."""
        due = 0.0
        while not self._stopping.wait(max(0.0, due - time.monotonic())):
            if not self._came.wait(0.1):
                continue
            with self.end.lock:
                self._came.clear()
                message, self._waiting = self._waiting, None
                due = time.monotonic() + period
                if message is not None:
                    self._publish(message)

    def _publish(self, message: Any) -> None:
        if self.end.now is None:
            self.counters.missed += 1
            return
        try:
            self._put(self.end.now, message)
            self.counters.passed += 1
        except ShmError as error:
            if isinstance(error, ValueRejected):
                self.counters.reject(str(error))
            else:
                self.counters.missed += 1
                self.end.meet(error)
        except Exception as error:  # whatever a ROS made of it: one message is not worth the topic
            self.counters.reject(f"{type(error).__name__}: {error}")

    def _put(self, region: Publisher[Message], message: Any) -> None:
        try:
            region.publish(message)
        except (StringTooLong, CountExceeded) as error:
            if self.route.topic.carried.overflow != "truncate":
                raise
            cut(message, self.route.layouts[self.route.wire.type], self.route.layouts)
            region.publish(message)
            self.counters.truncated += 1
            self.counters.complain(f"truncated: {error}")
