"""The backend ros1: topics and services through rospy, and a node that survives a restart of its master."""

from __future__ import annotations

import io
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import genpy
import rosgraph
import rospy
from rospy.impl import registration, tcpros_pubsub

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
from shmgen.bridge.common.support import SHUTDOWN_TIMEOUT, await_answer, from_bytes, sample_sender
from shmgen.bridge.ros1 import actions as ros1_actions
from shmgen.bridge.ros1 import types
from shmgen.runtime import Time

_CHECK_INTERVAL = 0.5
"""Seconds between two checks of the master."""
_CONNECT_TIMEOUT = 0.5
"""Timeout in seconds of a connection to the master's port."""


def connect(node: Node) -> Ros1 | None:
    """Wait for the master at ROS_MASTER_URI, and join the ROS graph. Return None if the bridge stops first."""
    if not _await_master(node):
        return None
    _remove_zero_sleeps()
    threading.Thread(target=_watch_master, args=(node,), daemon=True).start()
    try:
        rospy.init_node(node.name, argv=list(node.arguments), disable_signals=True, disable_rosout=True)
    except rospy.ROSException as error:
        if not node.stopping():
            raise ValueError(f"ros1: {error}") from None
    return None if node.stopping() else Ros1()


class Ros1(Backend):
    """The bridge's node in ROS 1, with the interface of a Backend. rospy allows one node in a process."""

    actions = ros1_actions

    def __init__(self) -> None:
        super().__init__()
        self.name = rospy.get_name().strip("/")

    def publisher(self, wire: Wire) -> RosPublisher:
        kind = types.message(wire.messages)
        raw = types.raw(kind)
        publisher = rospy.Publisher(wire.name, raw, queue_size=wire.queue, latch=wire.latch, tcp_nodelay=True)
        self.undo.append(publisher.unregister)

        def send(message: Any) -> None:
            into = io.BytesIO()
            message.serialize(into)
            publish(into.getvalue())

        def publish(data: bytes) -> None:
            publisher.publish(raw(data))

        return RosPublisher(kind, send, sample_sender(_check_direct(wire, kind), self.now, publish, is_ros1=True))

    def subscribe(self, wire: Wire, take: Callable[[Any], None], errors: ErrorSink) -> RosSubscription:
        kind = types.message(wire.messages)

        def decode(data: bytes) -> Any:
            try:
                return kind().deserialize(data)
            except genpy.DeserializationError as error:
                raise ValueError(str(error)) from None

        deliver = from_bytes(_check_direct(wire, kind), decode, take, errors, is_ros1=True)
        # Without a queue_size rospy delivers every message that a socket received.
        subscription = rospy.Subscriber(
            wire.name, types.raw(kind), lambda message: deliver(message.data), tcp_nodelay=True
        )
        self.undo.append(subscription.unregister)
        return RosSubscription(kind, lambda: subscription.get_num_connections() > 0)

    def serve(self, wire: ServiceWire, answer: Answer, errors: ErrorSink) -> None:
        kind = types.service(wire)

        def handle(request: Any) -> Any:
            response = kind._response_class()
            try:
                answer(request, response)
            except NoAnswer as error:
                raise rospy.ServiceException(str(error)) from None
            return response

        self.undo.append(rospy.Service(wire.name, kind, handle).shutdown)

    def client(self, wire: ServiceWire) -> RosClient:
        kind = types.service(wire)

        def call(request: Any, timeout: float) -> Any:
            return _within(timeout, lambda: rospy.ServiceProxy(wire.name, kind)(request))

        return RosClient(kind._request_class, call)

    def now(self) -> Time:
        stamp = rospy.Time.now()
        return Time(stamp.secs, stamp.nsecs)

    def alive(self) -> bool:
        return not rospy.is_shutdown()

    def close(self) -> None:
        leaving = threading.Thread(target=rospy.signal_shutdown, args=("the bridge stops",), daemon=True)
        leaving.start()
        leaving.join(SHUTDOWN_TIMEOUT)  # a service that is answering a call delays rospy for seconds


def _check_direct(wire: Wire, kind: Any) -> Wire:
    """Return `wire`, but without its direct conversion if the ROS class `kind` differs from `wire`'s definition.

    Such messages are then converted through message objects, which is slower.
    """
    return wire if types.means(kind, wire.messages) else replace(wire, direct=None)


def _remove_zero_sleeps() -> None:
    """Remove rospy's sleeps of zero seconds after each message. Each sleep takes 60 us and delays all topics."""
    tcpros_pubsub.time = SimpleNamespace(sleep=lambda seconds: time.sleep(seconds) if seconds else None)


def _within(seconds: float, call: Callable[[], Any]) -> Any:
    """Return the result of `call`, which runs in a thread. Raises NoAnswer if `call` fails, or after `seconds`."""
    answer: Future[Any] = Future()

    def run() -> None:
        try:
            answer.set_result(call())
        except Exception as error:
            answer.set_exception(NoAnswer(str(error)))

    threading.Thread(target=run, daemon=True).start()
    return await_answer(answer, seconds, time.monotonic() + seconds)


def _await_master(node: Node) -> bool:
    """Wait until the master answers, and return True. Return False if the bridge stops first."""
    is_logged = False
    while not node.stopping():
        if _reachable():
            return True
        if not is_logged:
            node.log(f"no ROS master at {rosgraph.get_master_uri()} (ROS_MASTER_URI); waiting for one")
            is_logged = True
        time.sleep(0.1)
    return False


def _watch_master(node: Node) -> None:
    """Register everything again with a restarted master, because rospy registers only once."""
    away = False
    due = 0.0
    while not rospy.is_shutdown():
        time.sleep(0.05)
        if node.stopping() and not rospy.core.is_initialized():
            rospy.signal_shutdown("the bridge stops")  # otherwise init_node waits for its master for ever
        if time.monotonic() < due or not rospy.core.is_initialized() or node.stopping():
            continue
        due = time.monotonic() + _CHECK_INTERVAL
        if not _reachable():
            if not away:
                node.log("the ROS master is unreachable; existing connections continue")
            away = True
            continue
        with suppress(OSError):  # the master went away since the check
            if not _known():
                node.log("the ROS master does not know this node; registering again")
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
    """Return True if the master's port accepts a connection. Unlike a call to the master, this has a timeout."""
    master = rosgraph.get_master_uri()
    try:
        host, port = rosgraph.network.parse_http_host_and_port(master)
    except ValueError as error:
        raise ValueError(f"ros1: ROS_MASTER_URI is {master!r}: {error}") from None
    try:
        socket.create_connection((host, port), _CONNECT_TIMEOUT).close()
    except OSError:
        return False
    return True
