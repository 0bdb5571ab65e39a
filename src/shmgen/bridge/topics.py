"""Topics: messages of ROS become samples of a region, and samples of a region messages of ROS."""

from __future__ import annotations

import struct
import threading
import time
from contextlib import suppress
from typing import Any

from shmgen.bridge import plan
from shmgen.bridge.backend import Backend
from shmgen.bridge.codec.cut import cut
from shmgen.bridge.counters import Counters
from shmgen.bridge.endpoint import ReopeningEndpoint
from shmgen.bridge.listener import Listener
from shmgen.bridge.plan import Route
from shmgen.live.classes import publisher, subscriber
from shmgen.runtime import CountExceeded, Message, Publisher, ShmError, StringTooLong, Subscriber, ValueRejected
from shmgen.runtime.messages.values import set_clock


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


class FromPlc:
    """A Side: what the PLC writes goes to ROS, by a thread that sleeps until it does.

    It shares `listener` with others; without one, and where it may have to wait itself, for a `rate` or for subscribers
    of large messages, it has its own.
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
        waits = route.topic.carried.rate or route.wire.is_large
        self._listener = listener if listener and not waits else Listener(stopping)

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
            lost = self._outlet.send(message) or 0
            self.counters.passed += 1 - lost
            if lost:
                self.counters.lose(lost)
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
