"""The bridge's ROS in memory: topics and services that all nodes of a process share."""

from __future__ import annotations

import queue
import threading
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from shmgen.bridge.backend import (
    Answer,
    Backend,
    ErrorSink,
    NoAnswer,
    Node,
    RosClient,
    RosPublisher,
    RosSubscription,
    ServiceWire,
    Wire,
)
from shmgen.bridge.codec.cdr import Codec, codec
from shmgen.bridge.ros2 import actions as ros2_actions

_SHUTDOWN_TIMEOUT = 0.3
"""Seconds that each thread of a node gets to end."""


@dataclass
class Topic:
    """A topic. `latched` has the newest message of each latching publisher."""

    inlets: list[Inlet] = field(default_factory=list)
    latched: dict[int, bytes] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)


TOPICS: defaultdict[str, Topic] = defaultdict(Topic)
SERVICES: dict[str, tuple[ServiceWire, Answer]] = {}
"""The server of each service. With TOPICS, this is the whole graph."""


def connect(node: Node) -> Memory | None:
    """Join the graph, which always exists."""
    return None if node.stopping() else Memory()


class Inlet:
    """A subscription: a queue, and one thread that empties it, so that messages keep their order."""

    def __init__(self, wire: Wire, codec_: Codec, take: Callable[[Any], None], errors: ErrorSink) -> None:
        self.waiting: queue.Queue[bytes | None] = queue.Queue(wire.queue)
        self._codec, self._take, self._errors, self._largest = codec_, take, errors, wire.largest
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def put(self, data: bytes | None) -> None:
        """Queue a message. If the queue is full, drop the oldest and count it as lost."""
        while True:
            try:
                self.waiting.put_nowait(data)
                return
            except queue.Full:
                self.waiting.get()
                self._errors.lose(1)

    def _run(self) -> None:
        while (data := self.waiting.get()) is not None:
            if len(data) > self._largest:
                self._errors.reject(f"{len(data)} bytes do not fit the region")
            else:
                self._take(self._codec.decode(data))


class Memory(Backend):
    """A Backend. The bridge builds actions from its topics and services in the way of ROS 2."""

    actions = ros2_actions

    def __init__(self) -> None:
        super().__init__()
        self._undo_all: list[Callable[[], None]] = []
        self._closed = threading.Event()

    def publisher(self, wire: Wire) -> RosPublisher:
        made, topic = codec(wire.messages), TOPICS[wire.name]
        number = id(made)

        def send(message: Any) -> None:
            data = made.encode(message)
            with topic.lock:
                if wire.latch:
                    topic.latched[number] = data
                for inlet in topic.inlets:
                    inlet.put(data)

        return RosPublisher(made.new, send)

    def subscribe(self, wire: Wire, take: Callable[[Any], None], errors: ErrorSink) -> RosSubscription:
        made, topic = codec(wire.messages), TOPICS[wire.name]
        inlet = Inlet(wire, made, take, errors)
        with topic.lock:
            for data in topic.latched.values():
                inlet.put(data)
            topic.inlets.append(inlet)

        def unsubscribe() -> None:
            with topic.lock:
                if inlet in topic.inlets:
                    topic.inlets.remove(inlet)
                    inlet.put(None)
            inlet.thread.join(_SHUTDOWN_TIMEOUT)

        self._ends_with(unsubscribe)
        return RosSubscription(made.new)

    def serve(self, wire: ServiceWire, answer: Answer, errors: ErrorSink) -> None:
        SERVICES[wire.name] = wire, answer
        self._ends_with(lambda: SERVICES.pop(wire.name, None))

    def client(self, wire: ServiceWire) -> RosClient:
        made, answered = codec(wire.request), codec(wire.response)

        def call(request: Any, timeout: float) -> Any:
            if wire.name not in SERVICES:
                raise NoAnswer("there is no server")
            _, answer = SERVICES[wire.name]
            asked, response = made.decode(made.encode(request)), answered.new()
            outcome: queue.Queue[str] = queue.Queue()

            def work() -> None:
                try:
                    answer(asked, response)
                    outcome.put("")
                except NoAnswer as error:
                    outcome.put(str(error))

            threading.Thread(target=work, daemon=True).start()
            try:
                why = outcome.get(timeout=timeout)
            except queue.Empty:
                why = f"no answer within {timeout:g} s"
            if why:
                raise NoAnswer(why)
            return answered.decode(answered.encode(response))

        return RosClient(made.new, call)

    def alive(self) -> bool:
        return not self._closed.is_set()

    def close(self) -> None:
        self._closed.set()
        for undo in self._undo_all:
            undo()

    def _ends_with(self, undo: Callable[[], object]) -> None:
        self.undo.append(undo)
        self._undo_all.append(undo)
