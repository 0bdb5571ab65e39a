"""The bridge's ROS 2: topics and services by rclpy.

Topics cross as bytes, each taken by a thread of its own; so do services, whose answers may take their time. rclpy's own
executor is left with what hardly ever happens: parameters, the clock, answers to our calls.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from typing import Any

import rclpy
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.signals import SignalHandlerOptions

from shmgen.bridge.backend import (
    Answer,
    MessageSink,
    NoAnswer,
    Node,
    Refuse,
    RosClient,
    RosPublisher,
    RosSubscription,
    ServiceWire,
    Wire,
    await_server,
    end_at_once,
)
from shmgen.bridge.codec.cdr import Codec, codec
from shmgen.bridge.codec.type_identity import TAKES_OURS, Identity
from shmgen.bridge.ros2 import actions as ros2_actions
from shmgen.bridge.ros2 import types
from shmgen.bridge.ros2.outlet import Outlet
from shmgen.bridge.ros2.peers import Peers
from shmgen.bridge.ros2.topics import Inlet
from shmgen.bridge.ros2.waiter import Ours, Waiter
from shmgen.core.model import Message
from shmgen.runtime import Time

_FAREWELL = 0.4
"""Seconds that all threads together get to finish what they are at."""
_PATIENCE = 0.1
"""Seconds that a call waits before it looks whether there still is a server."""


def connect(node: Node) -> Ros2:
    """Joins the graph of the domain. Raises ValueError for arguments that ROS does not know."""
    try:
        rclpy.init(
            args=list(node.arguments), domain_id=node.domain, signal_handler_options=SignalHandlerOptions.NO
        )  # signals are the bridge's own
        return Ros2(node)
    except Exception as error:  # rclpy has a class for each, and no word that is above them
        rclpy.try_shutdown()
        raise ValueError(f"ros2: {type(error).__name__}: {error}") from error


class Ros2:
    """A Backend."""

    actions = ros2_actions

    def __init__(self, node: Node) -> None:
        self._node: Any = rclpy.create_node(node.name)
        self._tell = node.tell
        self.undo: list[Callable[[], None]] = []
        self._waiters: list[Waiter] = []
        self._executor: Any = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="executor", daemon=True)
        self._thread.start()

    def publisher(self, wire: Wire) -> RosPublisher:
        kind, made = types.message(wire.messages), _codec(wire.messages)
        identity = Identity(wire.topic, wire.type, made.type_hash, self._tell, then=TAKES_OURS)

        def met(*event: Any) -> None:
            for one in self._node.get_subscriptions_info_by_topic(publisher.topic_name):
                identity.refusal(_hash(one))

        queue = 1 if wire.latch else wire.queue
        publisher = self._node.create_publisher(
            kind,
            wire.topic,
            _qos(wire, queue),
            event_callbacks=_when_matched(PublisherEventCallbacks, met),
        )
        self.undo.append(lambda: self._node.destroy_publisher(publisher))
        waits = wire.is_large and wire.qos == "reliable" and not wire.latch and hasattr(publisher, "wait_for_all_acked")
        outlet = Outlet(publisher, queue, self._closing.is_set) if waits else publisher
        return RosPublisher(made.new, lambda message: outlet.publish(made.encode(message)), keeps=False)

    def subscribe(self, wire: Wire, sink: MessageSink) -> RosSubscription:
        kind, made = types.message(wire.messages), _codec(wire.messages)
        subscription = self._node.create_subscription(
            kind,
            wire.topic,
            _never,
            _qos(wire, wire.queue),
            callback_group=Ours(),
            raw=True,
            event_callbacks=_when_matched(SubscriptionEventCallbacks, lambda event: inlet.look()),
        )
        identity = Identity(wire.topic, wire.type, made.type_hash, self._tell, wire.accepts_other)
        find = self._node.get_publishers_info_by_topic
        peers = Peers(identity, lambda: _hashes(find(subscription.topic_name)), sink.meet)
        inlet = Inlet(subscription, made, sink, peers, _rmw().startswith("rmw_fastrtps"))
        self._wait(subscription, "subscription", inlet.take, wire.topic)
        return RosSubscription(made.new, lambda: bool(subscription.handle.get_publisher_count()))

    def serve(self, wire: ServiceWire, answer: Answer, refuse: Refuse) -> None:
        kind = types.service(wire)
        request, response = _codec(wire.request), _codec(wire.response)
        service = self._node.create_service(kind, wire.service, _never, callback_group=Ours())
        find = self._node.get_publishers_info_by_topic
        peers = self._peers(wire, wire.request, request, find, f"rq{service.service_name}Request")

        def answered(asked: Any, whose: Any) -> None:
            message = response.new()
            try:
                answer(request.decode(serialize_message(asked)), message)
            except NoAnswer as error:  # ROS 2 has no word for it: the client waits in vain
                self._tell(f"{wire.service}: no answer: {error}")
                return
            with suppress(InvalidHandle):  # the bridge has ended meanwhile
                service.send_response(_rosidl(response, message, kind.Response), whose)

        def take() -> None:
            while not self._closing.is_set():
                asked, whose = service.handle.service_take_request(kind.Request)
                if whose is None:
                    peers.forget()
                    return
                peers.look()
                if why := peers.refusal():
                    refuse(why)
                elif wire.at_once:
                    work = self._guarded(partial(answered, asked, whose), wire.service)
                    threading.Thread(target=work, daemon=True).start()
                else:
                    answered(asked, whose)

        self._wait(service, "service", take, wire.service)

    def client(self, wire: ServiceWire) -> RosClient:
        kind = types.service(wire)
        request, response = _codec(wire.request), _codec(wire.response)
        client = self._node.create_client(kind, wire.service)
        self.undo.append(lambda: self._node.destroy_client(client))
        asked, replied = f"rq{client.service_name}Request", f"rr{client.service_name}Reply"
        listed = self._node.get_subscriptions_info_by_topic
        find = self._node.get_publishers_info_by_topic
        ends = (
            self._peers(wire, wire.request, request, listed, asked),
            self._peers(wire, wire.response, response, find, replied),
        )

        def check() -> None:
            """Nobody says whose an answer is, so that a server that has gone meanwhile counts too."""
            for peers in ends:
                peers.look()
                why = peers.refusal()
                peers.forget()
                if why:
                    raise NoAnswer(why)

        def servers() -> set[bytes]:
            return {bytes(end.endpoint_gid) for end in listed(asked, no_mangle=True)}

        def is_connected() -> bool:
            return self._closing.is_set() or client.service_is_ready()

        def call(message: Any, timeout: float) -> Any:
            deadline = await_server(is_connected, timeout)
            if self._closing.is_set():
                raise NoAnswer("the bridge ends")
            check()
            known, answered = servers(), threading.Event()
            future = client.call_async(_rosidl(request, message, kind.Request))
            future.add_done_callback(lambda future: answered.set())
            while not answered.wait(_PATIENCE):
                is_over, is_alone = time.monotonic() >= deadline, not known & servers()
                if self._closing.is_set() or is_over or is_alone:
                    client.remove_pending_request(future)
                    raise NoAnswer("the server has gone" if is_alone else f"no answer within {timeout:g} s")
            check()
            return response.decode(serialize_message(future.result()))

        return RosClient(request.new, call, is_connected)

    def now(self) -> Time:
        stamp = self._node.get_clock().now().to_msg()
        return Time(stamp.sec, stamp.nanosec)

    def alive(self) -> bool:
        return bool(rclpy.ok())

    def close(self) -> None:
        self._closing.set()
        for waiter in self._waiters:
            waiter.close()
        deadline = time.monotonic() + _FAREWELL
        ended = [waiter.join(max(0.0, deadline - time.monotonic())) for waiter in self._waiters]
        self._executor.shutdown(timeout_sec=0)
        self._thread.join(max(0.0, deadline - time.monotonic()))
        if all(ended) and not self._thread.is_alive():  # else somebody still has them in hand
            self._node.destroy_node()
        else:
            atexit.register(end_at_once)
        rclpy.try_shutdown()

    def _wait(self, entity: Any, kind: Any, take: Callable[[], None], name: str) -> None:
        waiter = Waiter(entity, kind, self._guarded(take, name), self._node.context, name)
        self._waiters.append(waiter)

        def undo() -> None:
            waiter.close()
            waiter.join(_FAREWELL)
            getattr(self._node, f"destroy_{kind}")(entity)
            self._waiters.remove(waiter)

        self.undo.append(undo)

    def _guarded(self, work: Callable[[], None], name: str) -> Callable[[], None]:
        def guarded() -> None:
            try:
                work()
            except InvalidHandle:
                raise
            except Exception as error:  # one message is not worth the topic
                self._tell(f"{name}: {type(error).__name__}: {error}")

        return guarded

    def _peers(self, wire: ServiceWire, messages: tuple[Message, ...], made: Codec, find: Any, topic: str) -> Peers:
        """Those at the other ends of that topic of DDS."""
        identity = Identity(wire.service, messages[-1].name, made.type_hash, self._tell)
        return Peers(identity, lambda: _hashes(find(topic, no_mangle=True)))

    def _spin(self) -> None:
        while not self._closing.is_set():
            try:
                self._executor.spin()
            except ExternalShutdownException:
                return
            except Exception as error:
                if not self._closing.is_set():
                    self._tell(f"{type(error).__name__}: {error}")


def _when_matched(callbacks: Any, met: Callable[..., None]) -> Any:
    """Not in a ROS before Iron, which knows no type hashes either."""
    try:
        return callbacks(matched=met)
    except TypeError:
        return callbacks()


def _never(*messages: Any) -> None:
    """What is taken by threads of ours calls nothing of rclpy's."""


def _hash(endpoint: Any) -> str:
    found = getattr(endpoint, "topic_type_hash", None)
    return str(found) if found is not None and found.version == 1 else ""


def _hashes(ends: Iterable[Any]) -> dict[bytes, str]:
    return {bytes(end.endpoint_gid)[:16]: _hash(end) for end in ends}


def _rosidl(made: Codec, message: Any, kind: Any) -> Any:
    return deserialize_message(made.encode(message), kind)


def _rmw() -> str:
    return str(rclpy.get_rmw_implementation_identifier())


def _codec(messages: tuple[Message, ...]) -> Codec:
    return codec(messages, 2 if _rmw() == "rmw_cyclonedds_cpp" else 4)


def _qos(wire: Wire, depth: int) -> QoSProfile:
    """A late subscriber gets as many as a writer keeps: of what is latched, the newest only."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(depth, 1),
        reliability=ReliabilityPolicy.RELIABLE if wire.qos == "reliable" else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if wire.latch else DurabilityPolicy.VOLATILE,
    )
