"""Carries topics: converts ROS messages to samples in a region, and samples to ROS messages."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from shmgen.bridge import plan
from shmgen.bridge.backend import Backend
from shmgen.bridge.codec.cut import cut
from shmgen.bridge.common.counters import Counters, describe
from shmgen.bridge.endpoint import POLL_INTERVAL, RegionEndpoint, Side
from shmgen.bridge.listener import Listener
from shmgen.bridge.plan import Route
from shmgen.live.classes import publisher, subscriber
from shmgen.runtime import CountExceeded, Message, Publisher, ShmError, StringTooLong, Subscriber, ValueRejected
from shmgen.runtime.messages.times import set_clock

_ACKNOWLEDGED_TIMEOUT = 4.0
"""Seconds to wait for a slow subscriber of large messages. Fast DDS resends a lost message within 3 s."""


class ToPlc(Side):
    """Carries a topic from ROS to the PLC."""

    def __init__(
        self,
        route: Route,
        counters: Counters,
        end: RegionEndpoint[Publisher[Message]] | None = None,
    ) -> None:
        """Open the region of the topic, or take over `end`, an open endpoint of the same region."""
        super().__init__(route, counters)
        self._waiting: Any = None
        """The message that waits for the rate limiter, or None."""
        self._waiting_changed = threading.Condition()
        topic = route.topic
        self.end = end or RegionEndpoint(lambda: publisher(route.kind, topic.topic, topic.depth), counters)

    def start(self, backend: Backend) -> None:
        if self.route.topic.carried.rate:
            threading.Thread(target=self._limit_rate, args=(1 / self.route.topic.carried.rate,), daemon=True).start()
        subscription = backend.subscribe(self.route.wire, self.take, self.counters)
        self.qos_problem = subscription.qos_problem
        plan.check(self.route, subscription.new())

    def take(self, message: Any) -> None:
        """Publish the message in the region, or store it for the rate limiter. Thread-safe."""
        self.counters.mark_received()
        if self.route.topic.carried.rate is None:
            self._publish(message)
        else:
            self._exchange(message)

    def _exchange(self, message: Any) -> None:
        """Store `message` for the rate limiter. If another message is still stored, drop and count that message."""
        with self._waiting_changed:
            self.counters.rate_limited += self._waiting is not None
            self._waiting = message
            self._waiting_changed.notify()

    def beat(self) -> None:
        """Send a heartbeat to the PLC, except if ROS has sent nothing for the time `stale` of shmgen.toml."""
        if (region := self.end.current) is not None and not self.silence():
            try:
                region.heartbeat()
            except ShmError as error:
                self.end.report(error)

    def silence(self) -> str:
        limit = self.route.topic.carried.stale
        age = self.counters.age
        if limit is None or (age is not None and age <= limit):
            return ""
        return f"no message from ROS for {limit:g} s or more"

    def stop(self) -> bool:
        """Stop the topic: drop the message that waits for the rate limiter."""
        self._exchange(None)
        return True

    def _limit_rate(self, period: float) -> None:
        """Publish the newest message, at most once in `period` seconds. The last message of a burst is not lost."""
        due = 0.0
        while not self.stopping.wait(max(0.0, due - time.monotonic())):
            with self._waiting_changed:
                if not self._waiting_changed.wait_for(lambda: self._waiting is not None, POLL_INTERVAL):
                    continue
                message, self._waiting = self._waiting, None
            due = time.monotonic() + period
            self._publish(message)

    def _publish(self, message: Any) -> None:
        if (region := self.end.current) is None:
            self.counters.missed += 1
            return
        try:
            self._put(region, message)
            self.counters.passed += 1
        except ShmError as error:
            if isinstance(error, ValueRejected):
                self.counters.reject(str(error))
            else:
                self.counters.missed += 1
                self.end.report(error)
        except Exception as error:  # any fault of a ROS message: one bad message must not stop the topic
            self.counters.reject(describe(error))

    def _put(self, region: Publisher[Message], message: Any) -> None:
        try:
            region.publish(message)
        except (StringTooLong, CountExceeded) as error:
            if self.route.topic.carried.overflow != "truncate":
                raise
            cut(message, self.route.kind)
            region.publish(message)
            self.counters.truncated += 1
            self.counters.log_rate_limited(f"truncated: {error}")


class FromPlc(Side):
    """Carries a topic from the PLC to ROS. Its thread sleeps until the PLC writes a sample.

    Most topics share the thread of `listener`. A topic with the key `rate` or with large messages may block a thread
    for long, and therefore has its own.
    """

    def __init__(
        self,
        route: Route,
        counters: Counters,
        listener: Listener | None = None,
        end: RegionEndpoint[Subscriber[Message]] | None = None,
    ) -> None:
        """Open the region of the topic, or take over `end`, an open endpoint of the same region."""
        super().__init__(route, counters)
        self._sending = threading.Lock()
        self._window: _SendWindow | None = None
        self._stale = False
        self._due = 0.0
        self._is_first = True
        self.end = end or RegionEndpoint(self._open_subscriber, counters)
        waits = route.topic.carried.rate or route.wire.is_large
        self._listener = listener if listener and not waits else Listener(self.stopping)

    def start(self, backend: Backend) -> None:
        wire = self.route.wire
        outlet, self._now = backend.publisher(wire), backend.now
        waits = wire.is_large and wire.qos != "best_effort" and not wire.latch
        if waits and outlet.acknowledged:
            self._window = _SendWindow(outlet.acknowledged, wire.queue, self.stopping.is_set)
        self._outlet, self._message, self.qos_problem = outlet, outlet.new(), outlet.qos_problem
        plan.check(self.route, self._message)
        self._listener.add(self)

    def beat(self) -> None:
        """Check whether the PLC is alive. A topic from the PLC sends no heartbeat."""
        self._listener.replace_blocked()
        limit = self.route.topic.carried.stale
        reader = self.end.current
        if limit is not None and reader is not None:
            with suppress(ShmError, ValueError):  # the listener closed the subscriber
                self._stale = reader.is_stale(limit)

    def silence(self) -> str:
        limit = self.route.topic.carried.stale
        return f"the PLC's heartbeat has not changed for {limit:g} s or more" if self._stale else ""

    def stop(self) -> bool:
        """Stop sending to ROS. Return False if a ROS call is still running."""
        self._listener.remove(self)
        if not self._sending.acquire(timeout=POLL_INTERVAL):
            return False
        self._sending.release()
        return True

    def take(self, reader: Subscriber[Message]) -> bool:
        rate = self.route.topic.carried.rate
        if rate:
            if self.stopping.wait(max(0.0, self._due - time.monotonic())):
                return True
            self._due = time.monotonic() + 1 / rate
            samples = [sample] if (sample := reader.read()) else []
        else:
            samples = reader.read_all()
        for sample in samples:
            with self._sending:
                if self.stopping.is_set():
                    self.counters.missed += 1
                else:
                    self._send(sample)
        self._count(reader)
        return bool(samples)

    def _send(self, sample: Message) -> None:
        self.counters.mark_received()
        try:
            lost = self._window.wait() if self._window else 0
            if not self._outlet.send_sample(sample):
                self.route.kind._decode(bytes(sample), self._message)
                if self.route.topic.carried.stamp == "now":
                    self._stamp(self._message)
                self._outlet.send(self._message)
            self.counters.passed += 1 - lost
            if lost:
                self.counters.lose(lost)
        except ValueRejected as error:
            self.counters.reject(str(error))
        except Exception as error:  # any exception of a ROS library: one bad message must not stop the bridge
            self.counters.reject(describe(error), " by ROS")

    def _stamp(self, message: Any) -> None:
        """Fill in an unset header stamp. ROS would take a zero stamp for a message from 1970."""
        *owners, name = self.route.stamp or ("",)
        if not name:
            return
        for owner in owners:
            message = getattr(message, owner)
        stamp = getattr(message, name)
        if not any(getattr(stamp, part, 0) for part in ("sec", "nanosec", "secs", "nsecs")):
            setattr(message, name, set_clock(stamp, self._now()))

    def _count(self, reader: Subscriber[Message]) -> None:
        missed = self.end.count_missed(reader.missed)
        if self.route.topic.carried.rate:
            self.counters.rate_limited += missed
        else:
            self.counters.missed += missed

    def _open_subscriber(self) -> Subscriber[Message]:
        topic = self.route.topic
        # A recreated region holds only samples written after the old region was removed, so read all of them.
        reader = subscriber(self.route.kind, topic.topic, topic.depth, history=not self._is_first)
        if self._is_first and not topic.carried.latch:
            # Skip old samples: a late ROS subscriber gets no old messages either, and an old command would be unsafe.
            reader.read()
        self._is_first = False
        return reader


class _SendWindow:
    """Delays large messages until slow subscribers have received enough of the earlier messages.

    The queue of a topic holds few large messages. If the queue is full, DDS overwrites the oldest message, even if a
    subscriber still waits for that message.

    Call `wait` before each send. While the queue may be full, `wait` blocks, and unsent samples stay in their region.
    After a timeout, `wait` returns 1 for each message that may be lost, until all messages are acknowledged.
    `acknowledged(seconds)` is the function of RosPublisher, and `queue` the length of the queue in messages.
    """

    def __init__(self, acknowledged: Callable[[float], bool], queue: int, is_over: Callable[[], bool]) -> None:
        self._acknowledged = acknowledged
        self._queue = queue
        self._is_over = is_over
        self._outstanding = 0
        self._is_late = False

    def wait(self) -> int:
        """Wait for a free place in the queue. Return 1 if the next send may overwrite an unreceived message, else 0."""
        if self._outstanding >= self._queue // 2:
            self._poll(0.0)  # cheap, and usually makes the wait below unnecessary
        deadline = time.monotonic() + (0 if self._is_late else _ACKNOWLEDGED_TIMEOUT)
        while self._outstanding >= self._queue and time.monotonic() < deadline and not self._is_over():
            self._poll(POLL_INTERVAL)
        self._is_late = self._outstanding >= self._queue
        self._outstanding += 1
        return int(self._is_late)

    def _poll(self, seconds: float) -> None:
        if self._acknowledged(seconds):
            self._outstanding = 0
