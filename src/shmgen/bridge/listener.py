"""Waits for samples in the regions of many topics in one thread, and lets each topic process its samples."""

from __future__ import annotations

import threading
import time
from typing import Any, Protocol

from shmgen.bridge.common.counters import Counters
from shmgen.bridge.endpoint import POLL_INTERVAL, RETRY_INTERVAL, RegionEndpoint
from shmgen.runtime import RegionRetired, ShmError, Subscriber, ready_any

_LOCK_INTERVAL = 0.001
"""The interval in seconds until the next attempt if samples are ready but none could be read."""
_BLOCK_LIMIT = 0.5
"""The maximum time in seconds that one topic may block the other topics."""


class PlcTopic(Protocol):
    """A topic from the PLC, whose samples a listener reads."""

    counters: Counters
    end: RegionEndpoint[Any]

    def take(self, reader: Subscriber[Any]) -> bool:
        """Forward the unread samples of `reader` to ROS. Return False if no sample could be read."""


class Listener:
    """A thread in which topics from the PLC forward samples to ROS. If a topic fails or blocks, the others continue."""

    def __init__(self, stopping: threading.Event) -> None:
        self._stopping = stopping
        self._topics: list[PlcTopic] = []
        self._readers: dict[Subscriber[Any], PlcTopic] = {}
        self._retry_at: dict[PlcTopic, float] = {}
        self._current: tuple[PlcTopic, float] | None = None
        """The topic that the thread processes and its start time (monotonic clock), or None while the thread waits."""
        self._blocked: list[PlcTopic] = []
        """Topics whose ROS call blocks a thread that was replaced."""
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def add(self, topic: PlcTopic) -> None:
        """Add a topic. The thread begins to read the topic's samples within 0.1 s."""
        self._topics.append(topic)
        if self._thread.ident is None:
            self._thread.start()

    def replace_blocked(self) -> None:
        """Start a new thread for the other topics if a ROS call of one topic has blocked this thread for 0.5 s."""
        with self._lock:
            if not self._current or len(self._topics) < 2 or time.monotonic() - self._current[1] < _BLOCK_LIMIT:
                return
            topic, self._current = self._current[0], None
            if topic in self._topics:
                self._topics.remove(topic)
            self._blocked.append(topic)
            self._readers = {}
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()
        topic.counters.log_rate_limited(
            f"a ROS call has blocked this topic for {_BLOCK_LIMIT:g} s; the other topics continue"
        )

    def remove(self, topic: PlcTopic) -> None:
        """Stop reading the topic. The caller then closes the subscriber, which ends calls that wait for a sample."""
        with self._lock:
            for topics in (self._topics, self._blocked):
                if topic in topics:
                    topics.remove(topic)

    def _run(self) -> None:
        due, own = 0.0, threading.current_thread()
        while self._thread is own and not self._stopping.is_set():
            left = due - time.monotonic()
            if left > 0:
                self._wait(left)
            else:
                due = time.monotonic() + POLL_INTERVAL
                self._update_readers()

    def _update_readers(self) -> None:
        """Collect the open subscribers of all topics in `_readers`, every 0.1 s. This takes a system call per topic."""
        self._readers = {}
        for topic in tuple(self._topics):
            if time.monotonic() >= self._retry_at.get(topic, 0.0):
                try:
                    if reader := topic.end.current:
                        reader.ready(0)  # raise the errors of this reader here, where the topic is known
                        self._readers[reader] = topic
                except Exception as error:
                    self._pause(topic, error)

    def _wait(self, seconds: float) -> None:
        readers = self._readers
        if not readers:
            self._stopping.wait(seconds)
            return
        try:
            ready = ready_any(readers, seconds)
        except ShmError:  # `_update_readers` finds the topic that failed
            self._readers = {}
            return
        is_any_read = False
        for reader in ready:
            topic = readers[reader]
            with self._lock:
                current = self._current = topic, time.monotonic()
            try:
                is_any_read |= topic.take(reader)
            except RegionRetired:  # the next call reopens the region
                del readers[reader]
            except Exception as error:
                del readers[reader]
                self._pause(topic, error)
            if self._is_replaced(current):
                return
        if ready and not is_any_read:
            self._stopping.wait(_LOCK_INTERVAL)

    def _is_replaced(self, current: tuple[PlcTopic, float]) -> bool:
        """Return True, and hand over the topic in `current`, if a new thread has replaced this thread."""
        with self._lock:
            if self._current is current:
                self._current = None
                return False
            if current[0] in self._blocked:
                self._blocked.remove(current[0])
                self._topics.append(current[0])
            return True

    def _pause(self, topic: PlcTopic, error: Exception) -> None:
        """Report any error of a topic and pause this topic for a while, so that the other topics continue."""
        if topic in self._topics:  # otherwise the topic was removed and closed
            topic.end.report(error)
            self._retry_at[topic] = time.monotonic() + RETRY_INTERVAL
