"""A stand-in for rclpy and the classes of rosidl, for there is no rclpy to be had here: what our backend calls.

It follows rclpy's source and rosidl_generator_py's template as we read them: classes take only values of the very type,
as with `ROS_PYTHON_CHECK_FIELDS=1`. Nodes of one process reach each other by name; QoS is recorded, not obeyed.
"""

from __future__ import annotations

import enum
import queue
import sys
import threading
import time
from collections.abc import Iterable
from types import ModuleType, SimpleNamespace
from typing import Any

from shmgen.model import Array, Clock, Field, Message, Ref, Scalar, Sequence, String

classes: dict[str, type] = {}
services: dict[str, SimpleNamespace] = {}
publishers: list[Any] = []
subscriptions: list[Any] = []
servers: dict[str, Any] = {}


def install(monkeypatch: Any, definitions: Iterable[Message]) -> None:
    """Into sys.modules, with a class for each definition."""
    for store in (classes, publishers, subscriptions, servers, services):
        store.clear()
    for name in ("Time", "Duration"):
        classes[f"builtin_interfaces/msg/{name}"] = _plain(name, {"sec": (int, 0), "nanosec": (int, 0)})
    for definition in definitions:
        classes[str(definition.name)] = message_class(definition)
    names = (str(definition.name) for definition in definitions)
    for name in [name.removesuffix("_Request") for name in names if name.endswith("_Request")]:
        services[name] = SimpleNamespace(Request=classes[f"{name}_Request"], Response=classes[f"{name}_Response"])
    for name, content in CONTENTS.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)


def init(*, args: list[str], domain_id: int | None, signal_handler_options: Any) -> None:
    init.arguments = (args, domain_id, signal_handler_options.name)  # type: ignore[attr-defined]


class Executor:
    """One thread does what many may."""

    def __init__(self) -> None:
        self.work: queue.Queue[Any] = queue.Queue()

    def add_node(self, node: Node) -> None:
        node.executor = self

    def spin_once(self, timeout_sec: float) -> None:
        try:
            self.work.get(timeout=timeout_sec)()
        except queue.Empty:
            return

    def shutdown(self, timeout_sec: float) -> None:
        pass


class Node:
    executor: Executor

    def __init__(self, name: str) -> None:
        self.name = name

    def create_publisher(self, kind: type, topic: str, qos: Any) -> Any:
        publishers.append(
            SimpleNamespace(kind=kind, topic=topic, qos=qos, publish=lambda message: _out(kind, topic, message))
        )
        return publishers[-1]

    def create_subscription(self, kind: type, topic: str, callback: Any, qos: Any, *, callback_group: Any) -> Any:
        subscriptions.append(SimpleNamespace(kind=kind, topic=topic, callback=callback, qos=qos, node=self))

    def create_service(self, kind: Any, name: str, callback: Any, *, callback_group: Any) -> Any:
        servers[name] = SimpleNamespace(kind=kind, callback=callback, node=self)

    def create_client(self, kind: Any, name: str, *, callback_group: Any) -> Any:
        return Client(kind, name)

    def get_clock(self) -> Any:
        stamp = SimpleNamespace(sec=int(time.time()), nanosec=7)
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: stamp))

    def destroy_node(self) -> None:
        pass


class Client:
    def __init__(self, kind: Any, name: str) -> None:
        self.kind, self.name = kind, name

    def wait_for_service(self, timeout_sec: float) -> bool:
        return self.name in servers

    def call_async(self, request: Any) -> Any:
        server, future = servers[self.name], Future()
        assert type(request) is self.kind.Request

        def work() -> None:
            response = server.callback(request, self.kind.Response())
            assert type(response) is self.kind.Response
            future.finish(response)

        server.node.executor.work.put(work)
        return future

    def remove_pending_request(self, future: Future) -> None:
        future.removed = True


class Future:
    removed = False

    def __init__(self) -> None:
        self.callbacks: list[Any] = []
        self.value: Any = None
        self.lock = threading.Lock()

    def add_done_callback(self, callback: Any) -> None:
        with self.lock:
            self.callbacks.append(callback)
            done = self.value is not None
        if done:
            callback(self)

    def finish(self, value: Any) -> None:
        with self.lock:
            self.value = value
        for callback in self.callbacks:
            callback(self)

    def result(self) -> Any:
        return self.value


def message_class(definition: Message) -> type:
    """As rosidl_generator_py makes it: defaults, and setters that assert."""
    return _plain(definition.name.name, {field.name: _rule(field) for field in definition.fields})


def _out(kind: type, topic: str, message: Any) -> None:
    assert type(message) is kind
    for subscription in subscriptions:
        if subscription.topic == topic:
            subscription.node.executor.work.put(lambda callback=subscription.callback: callback(message))


def _rule(field: Field) -> tuple[Any, Any]:
    match field.type:
        case Array(element, length):
            kind, make = _element(field, element)
            return [kind, length], lambda: [make() for _ in range(length)]
        case Sequence(element):
            return [_element(field, element)[0], None], list
        case element:
            return _element(field, element)


def _element(field: Field, type_: Any) -> tuple[Any, Any]:
    if field.written.split("[")[0] == "byte":
        return bytes, lambda: b"\0"
    match type_:
        case Scalar():
            kind = bool if type_ is Scalar.BOOL else float if type_.is_float else int
            return kind, kind
        case String():
            return str, str
        case Clock():
            kind = classes[f"builtin_interfaces/msg/{type_.name.title()}"]
            return kind, kind
        case Ref(name):
            return classes[str(name)], classes[str(name)]


def _plain(name: str, fields: dict[str, tuple[Any, Any]]) -> type:
    def begin(self: Any) -> None:
        for field, (_, make) in fields.items():
            object.__setattr__(self, field, make() if callable(make) else make)

    def put(self: Any, field: str, value: Any) -> None:
        kind = fields[field][0]
        if isinstance(kind, list):
            assert all(type(item) is kind[0] for item in value), f"{name}.{field}: {value!r}"
            assert kind[1] in (None, len(value)), f"{name}.{field}: {len(value)} elements"
        else:
            assert type(value) is kind, f"{name}.{field}: {value!r} is not {kind.__name__}"
            assert kind is not bytes or len(value) == 1
        object.__setattr__(self, field, value)

    known = dict.fromkeys(fields, "")
    body = {"__init__": begin, "__setattr__": put, "get_fields_and_field_types": classmethod(lambda cls: known)}
    return type(name, (), body)


CONTENTS: dict[str, dict[str, Any]] = {
    "rclpy": {"init": init, "create_node": Node, "ok": lambda: True, "try_shutdown": lambda: None},
    "rclpy.callback_groups": {
        "MutuallyExclusiveCallbackGroup": type("MutuallyExclusiveCallbackGroup", (), {}),
        "ReentrantCallbackGroup": type("ReentrantCallbackGroup", (), {}),
    },
    "rclpy.executors": {
        "MultiThreadedExecutor": Executor,
        "ExternalShutdownException": type("ExternalShutdownException", (Exception,), {}),
    },
    "rclpy.qos": {
        "HistoryPolicy": enum.Enum("HistoryPolicy", "KEEP_LAST"),
        "ReliabilityPolicy": enum.Enum("ReliabilityPolicy", "RELIABLE BEST_EFFORT"),
        "DurabilityPolicy": enum.Enum("DurabilityPolicy", "TRANSIENT_LOCAL VOLATILE"),
        "QoSProfile": SimpleNamespace,
    },
    "rclpy.signals": {"SignalHandlerOptions": enum.Enum("SignalHandlerOptions", "NO")},
    "rosidl_runtime_py": {},
    "rosidl_runtime_py.utilities": {"get_message": classes.__getitem__, "get_service": services.__getitem__},
}
"""Made once, as modules are: what imported from them keeps what it has."""
