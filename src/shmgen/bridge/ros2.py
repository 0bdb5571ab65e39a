"""The bridge's ROS 2: topics and services by rclpy, as thin as can be.

Written against rclpy's documentation and source (Humble to Jazzy), and run against a stand-in only.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from shmgen.bridge import ros2_types as types
from shmgen.bridge.backend import Answer, Caller, NoAnswer, Node, Outlet, ServiceWire, Wire
from shmgen.runtime import Time

_SPIN = 0.1
"""Seconds of the longest single wait for work."""


def connect(node: Node) -> Ros2:
    """Joins the graph of the domain."""
    rclpy.init(
        args=list(node.arguments), domain_id=node.domain, signal_handler_options=SignalHandlerOptions.NO
    )  # signals are the bridge's own
    return Ros2(node)


class Ros2:
    """A Backend. Each topic keeps its order by a callback group of its own; services may wait."""

    def __init__(self, node: Node) -> None:
        self._node = rclpy.create_node(node.name)
        self._executor = MultiThreadedExecutor()
        self._executor.add_node(self._node)
        self._tell = node.tell
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def publisher(self, wire: Wire) -> Outlet:
        kind = types.message(wire.messages)
        made = self._node.create_publisher(kind, wire.topic, _qos(wire))
        to_ros = types.to_ros(kind, wire.messages)
        return Outlet(types.blank(wire.messages), lambda message: made.publish(to_ros(message)))

    def subscribe(self, wire: Wire, callback: Callable[[Any], None]) -> Callable[[], Any]:
        kind = types.message(wire.messages)
        take = types.from_ros(wire.messages)
        self._node.create_subscription(
            kind,
            wire.topic,
            lambda message: callback(take(message)),
            _qos(wire),
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        return lambda: take(kind())

    def serve(self, wire: ServiceWire, answer: Answer) -> None:
        kind = types.service(wire)
        take, blank = types.from_ros(wire.request), types.blank(wire.response)
        to_ros = types.to_ros(kind.Response, wire.response)

        def handle(request: Any, response: Any) -> Any:
            filled = blank()
            answer(take(request), filled)
            return to_ros(filled)

        self._node.create_service(kind, wire.service, handle, callback_group=ReentrantCallbackGroup())

    def client(self, wire: ServiceWire) -> Caller:
        kind = types.service(wire)
        take, to_ros = types.from_ros(wire.response), types.to_ros(kind.Request, wire.request)
        client = self._node.create_client(kind, wire.service, callback_group=ReentrantCallbackGroup())

        def call(request: Any, timeout: float) -> Any:
            if not client.wait_for_service(timeout_sec=timeout):
                raise NoAnswer(f"no server within {timeout:g} s")
            answered = threading.Event()
            future = client.call_async(to_ros(request))
            future.add_done_callback(lambda future: answered.set())
            if not answered.wait(timeout):
                client.remove_pending_request(future)
                raise NoAnswer(f"no answer within {timeout:g} s")
            return take(future.result())

        return Caller(types.blank(wire.request), call)

    def now(self) -> Time:
        stamp = self._node.get_clock().now().to_msg()
        return Time(stamp.sec, stamp.nanosec)

    def alive(self) -> bool:
        return bool(rclpy.ok())

    def close(self) -> None:
        self._closing.set()
        self._thread.join(2 * _SPIN)
        self._executor.shutdown(timeout_sec=_SPIN)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _spin(self) -> None:
        while not self._closing.is_set():
            try:
                self._executor.spin_once(timeout_sec=_SPIN)
            except NoAnswer as error:  # ROS 2 has no word for a failed service: its client waits in vain
                self._tell(str(error))
            except ExternalShutdownException:
                return


def _qos(wire: Wire) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=wire.queue,
        reliability=ReliabilityPolicy.RELIABLE if wire.qos == "reliable" else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if wire.latch else DurabilityPolicy.VOLATILE,
    )
