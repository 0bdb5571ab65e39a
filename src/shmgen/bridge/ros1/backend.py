"""The bridge's ROS 1: topics and services by rospy, and a node that outlives its master."""

from __future__ import annotations

import io
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import genpy
import rosgraph
import rospy
from rospy.impl import registration, tcpros_pubsub

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
)
from shmgen.bridge.codec.wire_format import ROS1
from shmgen.bridge.ros1 import actions as ros1_actions
from shmgen.bridge.ros1 import types
from shmgen.runtime import Time

_WATCH = 0.5
"""Seconds between two looks at the master."""
_FAREWELL = 0.4
"""Seconds that rospy gets to leave."""
_REACH = 0.5
"""Seconds within which a master's port answers."""


def connect(node: Node) -> Ros1 | None:
    """Joins the graph of ROS_MASTER_URI as soon as there is one."""
    if not _await_master(node):
        return None
    _without_naps()
    threading.Thread(target=_watch_master, args=(node,), daemon=True).start()
    try:
        rospy.init_node(node.name, argv=list(node.arguments), disable_signals=True, disable_rosout=True)
    except rospy.ROSException as error:
        if not node.stopping():
            raise ValueError(f"ros1: {error}") from None
    return None if node.stopping() else Ros1()


class Ros1:
    """A Backend; rospy knows one node a process."""

    actions = ros1_actions

    def __init__(self) -> None:
        self.undo: list[Callable[[], None]] = []

    def publisher(self, wire: Wire) -> RosPublisher:
        kind = types.message(wire.messages)
        raw = types.raw(kind)
        made = rospy.Publisher(wire.topic, raw, queue_size=wire.queue, latch=wire.latch, tcp_nodelay=True)
        self.undo.append(made.unregister)

        def send(message: Any) -> None:
            into = io.BytesIO()
            message.serialize(into)
            made.publish(raw(into.getvalue()))

        if not wire.short or not types.means(kind, wire.messages):
            return RosPublisher(kind, send, keeps=False)
        encode = wire.short.out_of_region(ROS1, self.now)
        return RosPublisher(kind, send, False, lambda payload: made.publish(raw(encode(payload))))

    def subscribe(self, wire: Wire, sink: MessageSink) -> RosSubscription:
        kind = types.message(wire.messages)
        decode = wire.short.into_region(ROS1) if wire.short and types.means(kind, wire.messages) else None

        def take(message: Any) -> None:
            try:
                sink.take((decode and decode(message.data)) or kind().deserialize(message.data))
            except genpy.DeserializationError as error:
                sink.reject(str(error))

        # Without a queue_size rospy hands over every message that a socket brought.
        subscription = rospy.Subscriber(wire.topic, types.raw(kind), take, tcp_nodelay=True)
        self.undo.append(subscription.unregister)
        return RosSubscription(kind, lambda: subscription.get_num_connections() > 0)

    def serve(self, wire: ServiceWire, answer: Answer, refuse: Refuse) -> None:
        kind = types.service(wire)

        def handle(request: Any) -> Any:
            response = kind._response_class()
            try:
                answer(request, response)
            except NoAnswer as error:
                raise rospy.ServiceException(str(error)) from None
            return response

        self.undo.append(rospy.Service(wire.service, kind, handle).shutdown)

    def client(self, wire: ServiceWire) -> RosClient:
        kind = types.service(wire)

        def call(request: Any, timeout: float) -> Any:
            return _within(timeout, lambda: rospy.ServiceProxy(wire.service, kind)(request))

        return RosClient(kind._request_class, call)

    def now(self) -> Time:
        stamp = rospy.Time.now()
        return Time(stamp.secs, stamp.nsecs)

    def alive(self) -> bool:
        return not rospy.is_shutdown()

    def close(self) -> None:
        leaving = threading.Thread(target=rospy.signal_shutdown, args=("the bridge ends",), daemon=True)
        leaving.start()
        leaving.join(_FAREWELL)  # a service that answers somebody holds rospy up for seconds


def _without_naps() -> None:
    """Rospy gives up its turn behind each message that it queues, by a sleep of nothing; Linux makes 60 us of that, and
    all topics from the PLC would wait for it.
    """
    tcpros_pubsub.time = SimpleNamespace(sleep=_sleep)


def _sleep(seconds: float) -> None:
    if seconds:
        time.sleep(seconds)


def _within(seconds: float, call: Callable[[], Any]) -> Any:
    """Calls of rospy have no time limit, so one that nobody answers is left to its own thread."""
    result: list[Any] = []
    failure: list[Exception] = []

    def run() -> None:
        try:
            result.append(call())
        except Exception as error:
            failure.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds)
    if result:
        return result[0]
    raise NoAnswer(str(failure[0]) if failure else f"no answer within {seconds:g} s")


def _await_master(node: Node) -> bool:
    """False if the bridge is to stop before there is one."""
    told = False
    while not node.stopping():
        if _reachable():
            return True
        if not told:
            node.tell(f"no ROS master at {rosgraph.get_master_uri()} (ROS_MASTER_URI); waiting for one")
            told = True
        time.sleep(0.1)
    return False


def _watch_master(node: Node) -> None:
    """Registers everything again with a master that does not know this node: rospy itself never does."""
    away = False
    due = 0.0
    while not rospy.is_shutdown():
        time.sleep(0.05)
        if node.stopping() and not rospy.core.is_initialized():
            rospy.signal_shutdown("the bridge ends")  # or init_node would wait for its master for ever
        if time.monotonic() < due or not rospy.core.is_initialized() or node.stopping():
            continue
        due = time.monotonic() + _WATCH
        if not _reachable():
            if not away:
                node.tell("the ROS master is away; what is connected stays so")
            away = True
            continue
        with suppress(OSError):  # it went away in between
            if not _known():
                node.tell("the ROS master does not know this node; registering again")
                _register()
            away = False


def _known() -> bool:
    try:
        rosgraph.Master(rospy.get_name()).lookupNode(rospy.get_name())
    except rosgraph.MasterError:
        return False
    return True


def _register() -> None:
    topics, listeners = registration.get_topic_manager(), registration.get_registration_listeners()
    for name, type_name in topics.get_publications():
        listeners.notify_added(name, type_name, registration.Registration.PUB)
    for name, type_name in topics.get_subscriptions():
        listeners.notify_added(name, type_name, registration.Registration.SUB)
    for name, uri in registration.get_service_manager().get_services():
        listeners.notify_added(name, uri, registration.Registration.SRV)


def _reachable() -> bool:
    """Whether something listens there; unlike a call to the master this has a time limit."""
    master = rosgraph.get_master_uri()
    try:
        host, port = rosgraph.network.parse_http_host_and_port(master)
    except ValueError as error:
        raise ValueError(f"ros1: ROS_MASTER_URI is {master!r}: {error}") from None
    try:
        socket.create_connection((host, port), _REACH).close()
    except OSError:
        return False
    return True
