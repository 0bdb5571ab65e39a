"""What the bridge asks of a ROS: the one small interface that ros1, ros2 and dds are behind.

A backend is a module with `connect(node) -> Backend | None`, None if `node.stopping()` came true before there was a
graph to join; it raises BackendMissing. It knows nothing of regions; what it hands over and takes are messages with
ROS's attributes, whatever their class. All calls may come from any thread.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar

from shmgen.bridge.codec.direct import DirectPath
from shmgen.bridge.codec.wire_format import WireFormat
from shmgen.config.keys import MAX_DOMAIN
from shmgen.core.model import Message, TypeName
from shmgen.runtime import Time

QUEUE = 1000
"""Small messages a queue of a ROS holds: a second of a topic at 1 kHz, as long as Python may stand still."""
LARGEST = 2**16
"""Bytes that any message may have on its way. What is somewhat too long for its region still comes, to be counted."""
_SLACK = 4
"""So many times what its region holds may a larger one have."""
_MEMORY = 2**26
"""Bytes that the queue of a topic may come to."""
_COMPLAIN = 10.0
"""Seconds from one line about what a peer sends to the next."""
_LOOK = 0.01
_MOST = 1000
"""Peers at one end that are remembered, of those that have gone too."""

T = TypeVar("T")
V = TypeVar("V")


class BackendMissing(Exception):
    """What the backend is made of is not installed; the text says what to install."""


class NoAnswer(Exception):
    """A service call that ended without an answer; the text says why."""


@dataclass(frozen=True, slots=True)
class Node:
    """Who the bridge is in the graph. `domain` is DDS's, None = what ROS_DOMAIN_ID says.

    `tell` takes a line for whoever watches the bridge. `stopping` is true as soon as the bridge is to end.
    `arguments` are ROS's own of the command line, such as `__name:=x` or `--ros-args -r __node:=x`. `largest` is
    that of all wires.
    """

    name: str
    domain: int | None
    tell: Callable[[str], None]
    stopping: Callable[[], bool]
    arguments: tuple[str, ...] = ()
    largest: int = LARGEST


@dataclass(frozen=True, slots=True)
class Wire:
    """One topic as ROS sees it. `messages` are its definitions as written, dependencies first, its own type last.

    What is unbounded there is unbounded in ROS, whatever shmgen.toml bounds it to. `latch` keeps the newest message
    for late subscribers (ROS 2: transient local). `depth` is the region's, `room` the bytes of a message in it, and
    `short` the way between those and ROS's, where there is one.
    """

    topic: str
    messages: tuple[Message, ...]
    qos: Literal["reliable", "best_effort"] = "reliable"
    latch: bool = False
    depth: int = 1
    room: int = 0
    accepts_other: bool = False
    short: DirectPath | None = None

    @property
    def type(self) -> TypeName:
        return self.messages[-1].name

    @property
    def queue(self) -> int:
        """How many messages may wait in ROS."""
        return max(self.depth, queue_of(self.largest))

    @property
    def is_large(self) -> bool:
        """Whether less than a second of a topic at 1 kHz may wait."""
        return queue_of(self.largest) < QUEUE

    @property
    def largest(self) -> int:
        """Bytes that a message may have on its way; what is longer need not be read to know that it does not fit."""
        return largest(self.room)


def domain_without_ros(node: Node, backend: str) -> int:
    """The domain to join. Raises ValueError for one that cannot be."""
    if node.arguments:
        node.tell(f"{backend}: there is no ROS here to take {' '.join(node.arguments)}")
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() if node.domain is None else str(node.domain)
    if (not text.isdecimal() and text) or int(text or 0) > MAX_DOMAIN:
        where = "ROS_DOMAIN_ID" if node.domain is None else "shmgen.toml"
        raise ValueError(f"{backend}: a domain is a number from 0 to {MAX_DOMAIN}, not {text!r} as {where} says")
    return int(text or 0)


def queue_of(largest: int) -> int:
    """How many messages of so many bytes may wait: QUEUE small ones, one at least."""
    return max(1, min(QUEUE, _MEMORY // largest))


def largest(room: int) -> int:
    """Of messages that have `room` bytes in a region."""
    return max(LARGEST, _SLACK * room)


@dataclass(frozen=True, slots=True)
class ServiceWire:
    """One service as ROS sees it; `request` and `response` as `Wire.messages`.

    `at_once` has each call answered in a thread of its own, as some take for ever.
    """

    service: str
    request: tuple[Message, ...]
    response: tuple[Message, ...]
    at_once: bool = False

    @property
    def type(self) -> TypeName:
        """`std_srvs/srv/SetBool`."""
        return self.request[-1].name._replace(name=self.request[-1].name.name.removesuffix("_Request"))


@dataclass(frozen=True, slots=True)
class ActionWire:
    """One action as ROS sees it; `goal`, `result`, `feedback` as `Wire.messages`, `room` as there, of the largest."""

    action: str
    goal: tuple[Message, ...]
    result: tuple[Message, ...]
    feedback: tuple[Message, ...]
    room: int = 0

    @property
    def type(self) -> TypeName:
        """`control_msgs/action/GripperCommand`."""
        return self.goal[-1].name._replace(name=self.goal[-1].name.name.removesuffix("_Goal"))


class ErrorSink(Protocol):
    """Where what has come to nothing is told: from any thread."""

    def reject(self, why: str) -> None:
        """One that is no message: its bytes do not make one."""

    def refuse(self, why: str) -> None:
        """One of a peer that means something else by the type."""

    def meet(self, stranger: str) -> None:
        """Why nothing of such a peer that is there now may pass; nothing, as soon as none of them is there."""

    def lose(self, count: int) -> None:
        """So many that a publisher has sent and this ROS has handed to nobody."""


class MessageSink(ErrorSink, Protocol):
    """Where what comes from a topic goes: from any thread, but never two at once."""

    def take(self, message: Any) -> None:
        """One message."""


def from_bytes(
    wire: Wire, decode: Callable[[bytes], Any], wire_format: WireFormat, sink: MessageSink
) -> Callable[[bytes], None]:
    """What hands over the message that bytes make, by the short way where there is one, or rejects them."""
    straight = wire.short.into_region(wire_format) if wire.short else None

    def take(data: bytes) -> None:
        if len(data) > wire.largest:
            sink.reject(f"{len(data):,} bytes, and more than {wire.largest:,} are no message for its region")
            return
        try:
            message = (straight and straight(data)) or decode(data)
        except ValueError as error:
            sink.reject(str(error))
            return
        sink.take(message)

    return take


class RateLimitedLog:
    """Tells what a callback raises for what a peer sends, not often."""

    def __init__(self, name: str, tell: Callable[[str], None]) -> None:
        self._name, self._tell = name, tell
        self._told = float("-inf")

    def __call__(self, error: Exception) -> None:
        if time.monotonic() - self._told >= _COMPLAIN:
            self._told = time.monotonic()
            self._tell(f"{self._name}: {type(error).__name__}: {error}")


@dataclass(frozen=True, slots=True)
class RosPublisher:
    """A ROS publisher. `new()` makes an empty message, `send(message)` publishes one that `new` made.

    Lists in it may hold any objects with the attributes of the element's type, such as those of our own classes.
    `send` raises nothing for want of subscribers, and waits for them only where the wire `is_large`; it may give how
    many that it had sent were lost by it. What it `keeps` nobody changes later.
    `send_payload` does the same with the bytes of a sample; what it raises is to be sent as a message.
    """

    new: Callable[[], Any]
    send: Callable[[Any], int | None]
    keeps: bool = True
    send_payload: Callable[[bytes], None] | None = None


@dataclass(frozen=True, slots=True)
class RosSubscription:
    """A ROS subscription. `new()` makes an empty message, `is_connected()` says whether it hears a publisher now."""

    new: Callable[[], Any]
    is_connected: Callable[[], bool] = lambda: True


@dataclass(frozen=True, slots=True)
class RosClient:
    """A ROS service client. `new()` makes an empty request; `call(request, timeout in seconds)` gives the response.

    `call` raises NoAnswer: no server, no answer in time, or the server failed or went. Calls may overlap.
    `is_connected()` says whether there is a server now; also true when the bridge ends, so that nobody waits.
    """

    new: Callable[[], Any]
    call: Callable[[Any, float], Any]
    is_connected: Callable[[], bool] = lambda: True


def keep(known: dict[T, V], peer: T, what: V) -> None:
    """Forgets who was met first where there are very many: peers come and go as long as the bridge runs."""
    known[peer] = what
    if len(known) > _MOST:
        del known[next(iter(known))]


def await_server(is_connected: Callable[[], bool], timeout: float) -> float:
    """The deadline of what has to be over within `timeout`, as soon as there is a server. Raises NoAnswer."""
    deadline = time.monotonic() + timeout
    while not is_connected():
        if time.monotonic() >= deadline:
            raise NoAnswer(f"no server within {timeout:g} s")
        time.sleep(_LOOK)
    return deadline


def wall_clock() -> Time:
    """What is now, where a ROS has no clock of its own."""
    return Time(*divmod(time.time_ns(), 10**9))


def end_at_once() -> None:
    """For atexit, where a thread is still in a call of a ROS's library, whose destructors would fail the process."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


Answer = Callable[[Any, Any], None]
"""Fills the (request, response) of a service; raises NoAnswer, and the ROS client then hears so if its ROS can tell."""


Refuse = Callable[[str], None]
"""Is told why a client got no answer that means something else by the type."""


SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""How a goal ends, by the numbers of action_msgs/GoalStatus."""

Fill = Callable[[Any], None]
"""Writes a goal, a result or a feedback into an empty one."""


class Goal(Protocol):
    """One that a ROS client has sent."""

    request: Any

    def progress(self, fill: Fill) -> None:
        """Sends a feedback."""

    def end(self, status: int, fill: Fill) -> None:
        """Sends the result, the first time; `status` is one of the three above."""


class Worker(Protocol):
    """Who reaches goals. Its methods are called in threads where they may wait."""

    def begin(self, goal: Goal) -> bool:
        """Whether it is accepted; it may have ended by then."""

    def cancel(self, goal: Goal) -> bool:
        """Whether it will be tried; the goal ends when it can."""


class GoalObserver(Protocol):
    """Who waits for a goal that ROS reaches: from any thread, but never two at once."""

    def feedback(self, feedback: Any) -> None:
        """How far it is."""

    def end(self, status: int, result: Any, why: str = "") -> None:
        """How it ended, once; `result` is None where there is none, and `why` says so."""


class RosActionClient(Protocol):
    """The client of an action."""

    def send(self, fill: Fill, timeout: float, follower: GoalObserver) -> Callable[[], threading.Thread] | None:
        """Sends a goal; gives what asks to cancel it, in a thread that ends when that is sent. None: it was rejected.

        Raises NoAnswer where within `timeout` seconds there is no server or it does not accept; what it does then is
        cancelled.
        """


class Actions(Protocol):
    """How a kind of ROS makes actions of topics and services: `ros1/actions.py`, `ros2/actions.py`."""

    def serve(self, backend: Backend, wire: ActionWire, worker: Worker, mishaps: ErrorSink) -> object:
        """Offers the action. Raises as Backend.publisher()."""

    def seeker(self, backend: Backend, wire: ActionWire, mishaps: ErrorSink) -> RosActionClient:
        """Prepares goals of the action, which need not be there yet. Raises as Backend.publisher()."""


class Backend(Protocol):
    """A node in a ROS graph.

    Whatever it makes, it appends to `undo` what takes that back; the list is another whenever the bridge says so.
    """

    actions: Actions
    undo: list[Callable[[], None]]

    def publisher(self, wire: Wire) -> RosPublisher:
        """Advertises the topic. Raises ValueError for a type that this ROS has otherwise or not at all."""

    def subscribe(self, wire: Wire, sink: MessageSink) -> RosSubscription:
        """Hands each message to `sink`, in order. Raises as publisher()."""

    def serve(self, wire: ServiceWire, answer: Answer, refuse: Refuse) -> None:
        """Offers the service; `answer` is called in a thread where it may wait. Raises as publisher()."""

    def client(self, wire: ServiceWire) -> RosClient:
        """Prepares calls of the service, which need not be there yet. Raises as publisher()."""

    def now(self) -> Time:
        """The clock of the ROS: the wall's, or a simulation's."""

    def alive(self) -> bool:
        """False once ROS itself has told the node to end."""

    def close(self) -> None:
        """Leaves the graph, within half a second, whatever the peers do."""
