from collections.abc import Callable
from typing import Any, Protocol

from rclpy.callback_groups import CallbackGroup
from rclpy.qos import QoSProfile

class _Stamp(Protocol):
    sec: int
    nanosec: int

class _Time(Protocol):
    def to_msg(self) -> _Stamp: ...

class _Clock(Protocol):
    def now(self) -> _Time: ...

class _Publisher(Protocol):
    def publish(self, msg: Any) -> None: ...

class _Future(Protocol):
    def add_done_callback(self, callback: Callable[[_Future], None]) -> None: ...
    def result(self) -> Any: ...

class _Client(Protocol):
    def wait_for_service(self, timeout_sec: float | None = ...) -> bool: ...
    def call_async(self, request: Any) -> _Future: ...
    def remove_pending_request(self, future: _Future) -> None: ...

class Node:
    def create_publisher(self, msg_type: Any, topic: str, qos_profile: QoSProfile | int) -> _Publisher: ...
    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = ...,
    ) -> object: ...
    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        callback_group: CallbackGroup | None = ...,
    ) -> object: ...
    def create_client(self, srv_type: Any, srv_name: str, *, callback_group: CallbackGroup | None = ...) -> _Client: ...
    def get_clock(self) -> _Clock: ...
    def destroy_node(self) -> None: ...
