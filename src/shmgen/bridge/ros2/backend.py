"""The backend ros2: topics and services through rclpy. Topics pass as bytes.

Each subscription and each server has its own thread, because an answer may take long. The executor of rclpy handles
only rare events: parameters, the clock, and answers to the bridge's own calls.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from typing import Any

import rclpy
from rcl_interfaces.msg import Log
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions

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
from shmgen.bridge.codec.type_identity import TAKES_OURS, Identity
from shmgen.bridge.common import qos
from shmgen.bridge.common.peers import Peers
from shmgen.bridge.common.support import (
    SHUTDOWN_TIMEOUT,
    await_answer,
    await_server,
    from_bytes,
    guarded,
    join_all,
)
from shmgen.bridge.ros2 import actions as ros2_actions
from shmgen.bridge.ros2 import types
from shmgen.bridge.ros2.topics import Inlet
from shmgen.bridge.ros2.waiter import Ours, Waiter
from shmgen.core.model import Message
from shmgen.runtime import Time

_OVERRIDES = QoSOverridingOptions(
    (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)
)
"""The QoS policies that ROS parameters such as `qos_overrides.TOPIC.publisher.reliability` may set."""
_ROSOUT_DEPTH = 100
"""The number of log lines that a late subscriber of /rosout receives."""


def connect(node: Node) -> Ros2:
    """Join the ROS graph of the node's domain. Raises ValueError if ROS rejects an argument."""
    try:
        rclpy.init(
            args=list(node.arguments), domain_id=node.domain, signal_handler_options=SignalHandlerOptions.NO
        )  # the bridge handles signals itself
        return Ros2(node)
    except Exception as error:  # rclpy's exceptions share no base class
        rclpy.try_shutdown()
        raise ValueError(f"ros2: {type(error).__name__}: {error}") from error


class Ros2(Backend):
    """The bridge's node in ROS 2, with the interface of a Backend."""

    actions = ros2_actions

    def __init__(self, node: Node) -> None:
        self._node: Any = rclpy.create_node(node.name)
        self.name = str(self._node.get_name())
        self._log = node.log
        profile = _profile(qos.Qos(True, True), _ROSOUT_DEPTH)
        is_silent = "--disable-rosout-logs" in node.arguments
        self._rosout: Any = None if is_silent else self._node.create_publisher(Log, "/rosout", profile)
        super().__init__()
        self._waiters: list[Waiter] = []
        self._executor: Any = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="executor", daemon=True)
        self._thread.start()

    def publisher(self, wire: Wire) -> RosPublisher:
        kind, cdr = types.message(wire.messages), _codec(wire.messages)
        identity = Identity(wire.name, wire.type, cdr.type_hash, self._log, then=TAKES_OURS)

        listed = self._node.get_subscriptions_info_by_topic

        def check_peers(*event: Any) -> None:
            for one in listed(publisher.topic_name):
                identity.refusal(_hash(one))

        queue = 1 if wire.latch else wire.queue
        publisher = self._node.create_publisher(
            kind,
            wire.name,
            _profile(qos.ours(wire), queue),
            event_callbacks=PublisherEventCallbacks(matched=check_peers),
            qos_overriding_options=_OVERRIDES,
        )
        own = _policies(publisher)
        self.undo.append(lambda: self._node.destroy_publisher(publisher))

        def acknowledged(seconds: float) -> bool:
            return bool(publisher.wait_for_all_acked(Duration(seconds=seconds)))

        def qos_problem() -> str:
            return qos.problem(own, map(_policies, listed(publisher.topic_name)), publishes=True)

        return RosPublisher(
            cdr.new,
            lambda message: publisher.publish(cdr.encode(message)),
            acknowledged=acknowledged,
            qos_problem=qos_problem,
        )

    def subscribe(self, wire: Wire, take: Callable[[Any], None], errors: ErrorSink) -> RosSubscription:
        kind, cdr = types.message(wire.messages), _codec(wire.messages)
        identity = Identity(wire.name, wire.type, cdr.type_hash, self._log, wire.accepts_other)
        deliver = from_bytes(replace(wire, direct=None), cdr.decode, take, errors)
        find = self._node.get_publishers_info_by_topic
        name = self._node.resolve_topic_name(wire.name)
        is_fixed = f"qos_overrides.{name}.subscription.reliability" in self._node._parameter_overrides

        def create(policies: qos.Qos) -> tuple[Any, qos.Qos, Callable[[], None]]:
            inlet: Inlet
            is_adopted = policies != qos.ours(wire)  # the parameters are declared already, with the earlier QoS
            subscription = self._node.create_subscription(
                kind,
                wire.name,
                _never,
                _profile(policies, wire.queue),
                callback_group=Ours(),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(matched=lambda event: inlet.look()),
                qos_overriding_options=None if is_adopted else _OVERRIDES,
            )
            peers = Peers(identity, errors.set_incompatible_peer, lambda: _hashes(find(name)))
            inlet = Inlet(subscription, deliver, errors, peers, _rmw().startswith("rmw_fastrtps"))
            undo = self._call_on_data(subscription, "subscription", inlet.take, wire.name)
            return subscription, _policies(subscription), undo

        subscription = qos.AdoptingSubscription(
            replace(wire, qos="reliable") if is_fixed else wire, create, lambda: [_policies(end) for end in find(name)]
        )
        self.undo.append(subscription.undo)
        return RosSubscription(
            cdr.new, lambda: bool(subscription.end.handle.get_publisher_count()), subscription.qos_problem
        )

    def serve(self, wire: ServiceWire, answer: Answer, errors: ErrorSink) -> None:
        kind = types.service(wire)
        request, response = _codec(wire.request), _codec(wire.response)
        service = self._node.create_service(kind, wire.name, _never, callback_group=Ours())
        find = self._node.get_publishers_info_by_topic
        peers = self._peers(wire, wire.request, request, find, f"rq{service.service_name}Request")

        def reply(rosidl_request: Any, request_id: Any) -> None:
            message = response.new()
            try:
                answer(request.decode(serialize_message(rosidl_request)), message)
            except NoAnswer as error:  # ROS 2 has no error reply: the client waits until its timeout
                self._log(f"{wire.name}: no answer: {error}")
                return
            with suppress(InvalidHandle):  # the bridge has closed the service
                service.send_response(_rosidl(response, message, kind.Response), request_id)

        def take() -> None:
            while not self._closing.is_set():
                rosidl_request, request_id = service.handle.service_take_request(kind.Request)
                if request_id is None:
                    peers.forget()
                    return
                peers.look()
                if why := peers.refusal():
                    errors.refuse(why)
                elif wire.at_once:
                    work = guarded(reply, wire.name, self._log)
                    threading.Thread(target=work, args=(rosidl_request, request_id), daemon=True).start()
                else:
                    reply(rosidl_request, request_id)

        self.undo.append(self._call_on_data(service, "service", take, wire.name))

    def client(self, wire: ServiceWire) -> RosClient:
        kind = types.service(wire)
        request, response = _codec(wire.request), _codec(wire.response)
        client = self._node.create_client(kind, wire.name)
        self.undo.append(lambda: self._node.destroy_client(client))
        request_topic, reply_topic = f"rq{client.service_name}Request", f"rr{client.service_name}Reply"
        listed = self._node.get_subscriptions_info_by_topic
        find = self._node.get_publishers_info_by_topic
        ends = (
            self._peers(wire, wire.request, request, listed, request_topic),
            self._peers(wire, wire.response, response, find, reply_topic),
        )

        def check() -> None:
            """Raise NoAnswer if a server, also one that left since the last check, uses an incompatible type."""
            for peers in ends:
                peers.look()
                why = peers.refusal()
                peers.forget()
                if why:
                    raise NoAnswer(why)

        def servers() -> set[bytes]:
            return {bytes(end.endpoint_gid) for end in listed(request_topic, no_mangle=True)}

        def end_reason(known: set[bytes]) -> str:
            if self._closing.is_set():
                return "the bridge stops"
            return "" if known & servers() else "the server has left"

        def is_connected() -> bool:
            return self._closing.is_set() or client.service_is_ready()

        def call(message: Any, timeout: float) -> Any:
            deadline = await_server(is_connected, timeout)
            known = servers()
            if why := end_reason(known):
                raise NoAnswer(why)
            check()
            answer: Future[Any] = Future()
            future = client.call_async(_rosidl(request, message, kind.Request))
            future.add_done_callback(answer.set_result)
            try:
                await_answer(answer, timeout, deadline, lambda: end_reason(known))
            except NoAnswer:
                client.remove_pending_request(future)
                raise
            check()
            return response.decode(serialize_message(future.result()))

        return RosClient(request.new, call, is_connected)

    def now(self) -> Time:
        stamp = self._node.get_clock().now().to_msg()
        return Time(stamp.sec, stamp.nanosec)

    def publish_log(self, text: str) -> None:
        """Publish a warning on /rosout, in the executor's thread, because publishing may block."""

        def publish() -> None:
            with suppress(Exception):  # logging the exception would lead here again
                stamp, name = self._node.get_clock().now().to_msg(), self._node.get_logger().name
                self._rosout.publish(Log(stamp=stamp, level=int(LoggingSeverity.WARN), name=name, msg=text))

        if self._rosout:
            with suppress(Exception):  # the executor has ended
                self._executor.create_task(publish)

    def alive(self) -> bool:
        return bool(rclpy.ok())

    def close(self) -> None:
        self._closing.set()
        for waiter in self._waiters:
            waiter.close()
        self._executor.shutdown(timeout_sec=0)
        if join_all([*(waiter.thread for waiter in self._waiters), self._thread]):  # no thread uses the node
            self._node.destroy_node()
        rclpy.try_shutdown()

    def _call_on_data(self, entity: Any, kind: Any, take: Callable[[], None], name: str) -> Callable[[], None]:
        """Call `take` in a new thread when `entity` receives data. Return a function that destroys the entity."""
        guarded_take = guarded(take, name, self._log, InvalidHandle)
        waiter = Waiter(entity, kind, guarded_take, self._node.context, name)
        self._waiters.append(waiter)

        def undo() -> None:
            waiter.close()
            waiter.thread.join(SHUTDOWN_TIMEOUT)
            getattr(self._node, f"destroy_{kind}")(entity)
            self._waiters.remove(waiter)

        return undo

    def _peers(self, wire: ServiceWire, messages: tuple[Message, ...], cdr: Codec, find: Any, topic: str) -> Peers:
        """Return the peers of `topic`, the DDS topic of a service's requests or replies, that `find(topic)` returns."""
        identity = Identity(wire.name, messages[-1].name, cdr.type_hash, self._log)
        return Peers(identity, hashes=lambda: _hashes(find(topic, no_mangle=True)))

    def _spin(self) -> None:
        while not self._closing.is_set():
            try:
                self._executor.spin()
            except ExternalShutdownException:
                return
            except Exception as error:
                if not self._closing.is_set():
                    self._log(f"{type(error).__name__}: {error}")


def _never(*messages: Any) -> None:
    """Do nothing. rclpy requires a callback, but the bridge's own threads take the messages."""


def _hash(endpoint: Any) -> str:
    type_hash = getattr(endpoint, "topic_type_hash", None)
    return str(type_hash) if type_hash is not None and type_hash.version == 1 else ""


def _hashes(ends: Iterable[Any]) -> dict[bytes, str]:
    return {bytes(end.endpoint_gid)[:16]: _hash(end) for end in ends}


def _rosidl(cdr: Codec, message: Any, kind: Any) -> Any:
    return deserialize_message(cdr.encode(message), kind)


def _rmw() -> str:
    return str(rclpy.get_rmw_implementation_identifier())


def _codec(messages: tuple[Message, ...]) -> Codec:
    return codec(messages, 2 if _rmw() == "rmw_cyclonedds_cpp" else 4)


def _profile(policies: qos.Qos, depth: int) -> QoSProfile:
    """Return rclpy's QoS profile for `policies` and a queue of `depth` messages."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(depth, 1),
        reliability=ReliabilityPolicy.RELIABLE if policies.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if policies.latched else DurabilityPolicy.VOLATILE,
    )


def _policies(end: Any) -> qos.Qos:
    """Return the QoS policies of a publisher or subscription of the bridge, or of a peer in the graph."""
    profile = end.qos_profile
    is_latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return qos.Qos(profile.reliability != ReliabilityPolicy.BEST_EFFORT, is_latched)
