"""The interface of the backends, which connect the bridge to ROS: `ros1/`, `ros2/`, `dds/` and `zenoh/` implement it.

A backend is a module with a function `connect(node) -> Backend | None`. The function returns None if `node.stopping()`
became true before the backend could join a ROS graph, and raises BackendMissing if a library is not installed. Backends
have no access to regions. They receive and return messages of any class that has the attributes of the ROS message. All
functions are thread-safe.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol, cast

from shmgen.bridge.codec.direct import Transcoder
from shmgen.core.model import Message, TypeName
from shmgen.runtime import Time

QUEUE = 1000
"""The maximum queue length in messages. It covers 1 s of a topic at 1 kHz, because Python may pause that long."""
LARGEST = 2**16
"""The minimum size limit of a message in bytes: high, to receive and count messages too long for the region."""
_SLACK = 4
"""The size limit of a large serialized message, as a multiple of the size of its sample in the region."""
_MEMORY = 2**26
"""The maximum size of a topic's queue in bytes."""


class BackendMissing(Exception):
    """A library that the backend needs is not installed. The text names the package to install."""


class NoAnswer(Exception):
    """A service call or a goal ended without an answer. The text is the reason."""


@dataclass(frozen=True, slots=True)
class Node:
    """The settings of the bridge's node in the ROS graph. `domain` is the DDS domain, or None for ROS_DOMAIN_ID.

    `log` logs a line for the user. `stopping` returns True once the bridge has to stop. `arguments` are the ROS
    arguments of the command line, such as `__name:=x` or `--ros-args -r __node:=x`. `largest` is the size limit in
    bytes of serialized messages: the maximum of the limits of all topics, services and actions.
    """

    name: str
    domain: int | None
    log: Callable[[str], None]
    stopping: Callable[[], bool]
    arguments: tuple[str, ...] = ()
    largest: int = LARGEST
    namespace: str = "/"


@dataclass(frozen=True, slots=True)
class Wire:
    """The ROS side of a topic: the settings from which a backend creates a publisher or a subscription.

    * `messages`: the ROS definitions, dependencies first, the topic's type last. Bounds of shmgen.toml do not apply.
    * `qos`: with `auto`, a subscription adopts best effort if a publisher offers only best effort.
    * `latch`: True to keep the newest message for late subscribers (ROS 2: transient local).
    * `depth`: the number of newest samples that the region keeps. `sample_size`: the size of a sample in bytes.
    * `accepts_other`: True to accept messages of a peer whose type hash differs from the bridge's.
    * `direct`: converts samples to serialized ROS messages and back, or None if the topic has no direct conversion.
    """

    name: str
    messages: tuple[Message, ...]
    qos: Literal["auto", "reliable", "best_effort"] = "auto"
    latch: bool = False
    depth: int = 1
    sample_size: int = 0
    accepts_other: bool = False
    direct: Transcoder | None = None

    @property
    def type(self) -> TypeName:
        return self.messages[-1].name

    @property
    def queue(self) -> int:
        """The queue length in ROS, in messages."""
        return max(self.depth, queue_of(self.largest))

    @property
    def is_large(self) -> bool:
        """True if the messages are so large that the queue holds fewer than QUEUE messages."""
        return queue_of(self.largest) < QUEUE

    @property
    def largest(self) -> int:
        """The size limit of a serialized message in bytes. Backends reject longer messages without decoding them."""
        return largest(self.sample_size)


def queue_of(largest: int) -> int:
    """Return the queue length for messages of `largest` bytes: from 1 to QUEUE messages."""
    return max(1, min(QUEUE, _MEMORY // largest))


def largest(sample_size: int) -> int:
    """Return the size limit in bytes of a serialized message whose sample in the region has `sample_size` bytes."""
    return max(LARGEST, _SLACK * sample_size)


@dataclass(frozen=True, slots=True)
class ServiceWire:
    """The ROS side of a service: the settings from which a backend creates a server or a client.

    `request` holds the definitions of all messages that the request contains, and the request itself as the last one.
    `response` holds the same for the response. If `at_once` is True, each call runs in its own thread, so that a call
    that never ends delays no other call.
    """

    name: str
    request: tuple[Message, ...]
    response: tuple[Message, ...]
    at_once: bool = False

    @property
    def type(self) -> TypeName:
        """The type of the service, for example `std_srvs/srv/SetBool`."""
        return self.request[-1].name._replace(name=self.request[-1].name.name.removesuffix("_Request"))


@dataclass(frozen=True, slots=True)
class ActionWire:
    """The ROS side of an action: the settings from which a backend creates a server or a client.

    `goal` holds the definitions of all messages that the goal contains, and the goal itself as the last one. `result`
    and `feedback` hold the same for these messages. `sample_size` is the size in bytes of the action's largest sample.
    """

    name: str
    goal: tuple[Message, ...]
    result: tuple[Message, ...]
    feedback: tuple[Message, ...]
    sample_size: int = 0

    @property
    def type(self) -> TypeName:
        """The type of the action, for example `control_msgs/action/GripperCommand`."""
        return self.goal[-1].name._replace(name=self.goal[-1].name.name.removesuffix("_Goal"))


class ErrorSink(Protocol):
    """The interface by which a backend reports messages that could not be delivered. Thread-safe."""

    def reject(self, why: str) -> None:
        """Count a message whose bytes could not be decoded. `why` is the reason."""

    def refuse(self, why: str) -> None:
        """Count a message of an incompatible peer. `why` is the reason."""

    def set_incompatible_peer(self, reason: str) -> None:
        """Set the reason why a connected peer is incompatible, or `""` if no incompatible peer is connected."""

    def lose(self, count: int) -> None:
        """Count `count` messages that a publisher sent and that ROS never delivered to the bridge."""


@dataclass(frozen=True, slots=True)
class RosPublisher:
    """The functions by which the bridge publishes on a ROS topic.

    * `new()` creates an empty message. Its lists accept any objects with the attributes of the element's type.
    * `send(message)` publishes a message from `new`, without waiting for subscribers. The message can then be reused.
    * `send_sample(sample)` publishes a sample by its direct conversion. If there is none, or if a field is invalid, the
      function returns False. Then decode the sample and use `send`.
    * `acknowledged(seconds)` waits until all reliable subscribers have all messages, and returns False after a timeout.
      None if this ROS has no acknowledgements.
    * `qos_problem()` returns the reason why a subscriber has incompatible QoS, or `""` if all subscribers match.
    """

    new: Callable[[], Any]
    send: Callable[[Any], None]
    send_sample: Callable[[Any], bool] = lambda sample: False
    acknowledged: Callable[[float], bool] | None = None
    qos_problem: Callable[[], str] = lambda: ""


@dataclass(frozen=True, slots=True)
class RosSubscription:
    """The functions of a subscription to a ROS topic.

    * `new()` creates an empty message.
    * `is_connected()` returns True if a publisher is connected.
    * `qos_problem()`, which the bridge calls twice a second, adopts the QoS of the publishers if shmgen.toml permits
      that. It returns the reason why a publisher still has incompatible QoS, or `""` if all publishers match.
    """

    new: Callable[[], Any]
    is_connected: Callable[[], bool] = lambda: True
    qos_problem: Callable[[], str] = lambda: ""


@dataclass(frozen=True, slots=True)
class RosClient:
    """The functions by which the bridge calls a ROS service.

    * `new()` creates an empty request.
    * `call(request, timeout in seconds)` returns the response. Calls of several threads may overlap. It raises NoAnswer
      if no server is available, if the timeout expires, or if the server fails or disappears.
    * `is_connected()` returns True if a server is available, or if the bridge stops, so that no thread waits longer.
    """

    new: Callable[[], Any]
    call: Callable[[Any, float], Any]
    is_connected: Callable[[], bool] = lambda: True


Answer = Callable[[Any, Any], None]
"""A callback that reads a request and fills a response. It raises NoAnswer if the PLC did not answer."""


SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""The final states of a goal, with the numbers of action_msgs/GoalStatus."""

Fill = Callable[[Any], None]
"""A callback that fills an empty goal, result or feedback message."""


class Goal(Protocol):
    """A goal that a ROS client has sent, with the functions that send its feedback and its result to this client."""

    request: Any

    def progress(self, fill: Fill) -> None:
        """Send a feedback message to the client of this goal. `fill` fills the empty message."""

    def end(self, status: int, fill: Fill) -> None:
        """Send the result and `status` (SUCCEEDED, CANCELED or ABORTED) to the client. Later calls have no effect."""


class Worker(Protocol):
    """The PLC's side of an action: executes the goals of ROS clients. Each method may block its thread."""

    def begin(self, goal: Goal) -> bool:
        """Start the goal. Return True if the PLC accepts the goal, which may already have ended by then."""

    def cancel(self, goal: Goal) -> bool:
        """Start to cancel the goal, which ends later. Return False if the goal cannot be canceled."""


class GoalObserver(Protocol):
    """The interface by which a backend passes on the feedback and the result of a goal of ROS. Thread-safe."""

    def feedback(self, feedback: Any) -> None:
        """Receive a feedback message of the goal from the backend."""

    def end(self, status: int, result: Any, why: str = "") -> None:
        """Receive the final status and the result of the goal, once. If `result` is None, `why` is the reason."""


class RosActionClient(Protocol):
    """A client of a ROS action: sends goals that the ROS server executes."""

    def send(self, fill: Fill, timeout: float, follower: GoalObserver) -> Callable[[], object] | None:
        """Let `fill` fill an empty goal, and send the goal. Return None if the server rejects the goal.

        If the server accepts the goal, return a function that cancels the goal and may block the caller for 2 s.
        `follower` receives the feedback and the result. Raises NoAnswer, and cancels the goal, if the server does not
        answer within `timeout` seconds.
        """


class Actions(Protocol):
    """Creates servers and clients of actions.

    Both methods raise ValueError if ROS lacks the action type, or if its definition of the type differs from shmgen's.
    """

    def serve(self, backend: Backend, wire: ActionWire, worker: Worker, errors: ErrorSink) -> object:
        """Offer the action to ROS. `worker` executes the goals that ROS clients send."""

    def action_client(self, backend: Backend, wire: ActionWire, errors: ErrorSink) -> RosActionClient:
        """Create a client of the action, even if no server is available yet."""


class Backend(ABC):
    """The bridge's node in a ROS graph, which creates publishers, subscriptions, clients and servers.

    Each creating method raises ValueError if ROS lacks the type, or if the definition in ROS differs from shmgen's.
    """

    actions: Actions
    name = ""
    """The name of the node if ROS has parsed its arguments, or else `""`."""

    def __init__(self) -> None:
        self._of_thread = threading.local()

    @property
    def undo(self) -> list[Callable[[], object]]:
        """The functions that remove all that this thread has created in ROS. A thread may assign an empty list."""
        return cast(list[Callable[[], object]], self._of_thread.__dict__.setdefault("undo", []))

    @undo.setter
    def undo(self, steps: list[Callable[[], object]]) -> None:
        self._of_thread.undo = steps

    @abstractmethod
    def publisher(self, wire: Wire) -> RosPublisher:
        """Create a publisher of the topic."""

    @abstractmethod
    def subscribe(self, wire: Wire, take: Callable[[Any], None], errors: ErrorSink) -> RosSubscription:
        """Subscribe to the topic. `take` receives the messages in order, from one thread at a time."""

    @abstractmethod
    def serve(self, wire: ServiceWire, answer: Answer, errors: ErrorSink) -> None:
        """Offer the service to ROS. `answer` fills the response to each request, and may block its thread.

        `errors.refuse` receives the reason if an incompatible client gets no response.
        """

    @abstractmethod
    def client(self, wire: ServiceWire) -> RosClient:
        """Create a client of the service, even if no server is available yet."""

    def now(self) -> Time:
        """Return the ROS time: by default the time of the wall clock."""
        return Time(*divmod(time.time_ns(), 10**9))

    def alive(self) -> bool:
        """Return True until ROS shuts down the bridge's node: by default always."""
        return True

    def publish_log(self, text: str) -> None:  # noqa: B027 most graphs have no topic for log lines
        """Publish a log line of the bridge in the ROS graph. Do nothing by default."""

    @abstractmethod
    def close(self) -> None:
        """Leave the graph within 0.5 s, even if peers do not respond."""
