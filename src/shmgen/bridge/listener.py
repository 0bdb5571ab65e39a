"""Waits for samples in the regions of many topics, in one thread, and hands them on topic by topic."""

from __future__ import annotations

import threading
import time
from typing import Any, Protocol

from shmgen.bridge.counters import Counters
from shmgen.bridge.endpoint import LOOK
from shmgen.runtime import RegionRetired, ShmError, Subscriber, ready_any

_AGAIN = 0.5
"""Seconds until a region that could not be read is tried again."""
_LOCKED_OUT = 0.001
"""Seconds until the next try where there are samples, and none could be read."""


class Heard(Protocol):
    """A topic from the PLC."""

    counters: Counters

    def renewed(self) -> Subscriber[Any] | None:
        """The end of the region that is there now, or None; is asked for each LOOK."""

    def take(self, reader: Subscriber[Any]) -> bool:
        """Passes on what is unread; False: could read nothing."""


class Listener:
    """A thread that sleeps until the PLC has written to one of its topics. One that fails holds up no other."""

    def __init__(self, stopping: threading.Event) -> None:
        self._stopping = stopping
        self._topics: list[Heard] = []
        self._readers: dict[Subscriber[Any], Heard] = {}
        self._failed: dict[Heard, float] = {}
        self._patience = 3 * LOOK
        self._looks = 0
        self._thread = threading.Thread(target=self._run, daemon=True)

    def add(self, topic: Heard) -> None:
        """From now on, or the next LOOK."""
        self._topics.append(topic)
        if self._thread.ident is None:
            self._thread.start()

    def forget(self, topic: Heard) -> bool:
        """Whether it is let go of, after some patience."""
        if topic in self._topics:
            self._topics.remove(topic)
        before, end = self._looks, time.monotonic() + self._patience
        while not self._stopping.is_set() and self._looks < before + 2 and time.monotonic() < end:
            time.sleep(LOOK / 10)
        return self._looks >= before + 2 or self.ended()

    def ended(self) -> bool:
        """Whether no topic is at work, after some patience the first time that `stopping` is set."""
        patience, self._patience = self._patience, 0.0
        if self._thread.ident is not None:  # it was started
            self._thread.join(patience)
        return not self._thread.is_alive()

    def _run(self) -> None:
        due = 0.0
        while not self._stopping.is_set():
            left = due - time.monotonic()
            if left > 0:
                self._hear(left)
            else:
                due = time.monotonic() + LOOK
                self._look()

    def _look(self) -> None:
        """For every sample that would cost a system call for each region."""
        self._readers = {}
        for topic in tuple(self._topics):
            if time.monotonic() >= self._failed.get(topic, 0.0):
                try:
                    if reader := topic.renewed():
                        reader.ready(0)  # whatever it cannot do is said now, of this one
                        self._readers[reader] = topic
                except Exception as error:
                    self._fail(topic, error)
        self._looks += 1

    def _hear(self, seconds: float) -> None:
        if not self._readers:
            self._stopping.wait(seconds)
            return
        try:
            found = ready_any(self._readers, seconds)
        except ShmError:  # the next look says of which topic
            self._readers = {}
            return
        taken = False
        for reader in found:
            topic = self._readers[reader]
            try:
                taken |= topic.take(reader)
            except RegionRetired:  # the next look opens what is there now
                del self._readers[reader]
            except Exception as error:
                del self._readers[reader]
                self._fail(topic, error)
        if found and not taken:
            self._stopping.wait(_LOCKED_OUT)

    def _fail(self, topic: Heard, error: Exception) -> None:
        """Whatever it is: one topic is not worth the others."""
        expected = isinstance(error, (ShmError, OSError))
        topic.counters.complain(str(error) if expected else f"{type(error).__name__}: {error}")
        self._failed[topic] = time.monotonic() + _AGAIN
