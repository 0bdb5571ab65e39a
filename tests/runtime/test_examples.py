"""Runs the example in the docstring of each public class, against a peer in a thread."""

from __future__ import annotations

import inspect
import re
import select
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest

from shmgen import runtime
from shmgen.config import Config
from shmgen.config.entries import Bounds
from shmgen.generator import pipeline

from ..support.build import forget, put

PACKAGE = "shm_examples"
TYPES = ["geometry_msgs/Pose", "geometry_msgs/Point", "std_srvs/SetBool", "demo_msgs/Fibonacci"]
ACTION = "int32 order\n---\nint32[<=8] sequence\n---\nint32[<=8] sequence\n"
CLASSES = {
    name: value
    for name, value in vars(runtime).items()
    if inspect.isclass(value) and name in runtime.__all__ and not issubclass(value, runtime.ShmError)
} | {"ShmError": runtime.ShmError, "ValueRejected": runtime.ValueRejected}
"""The public classes, and the two base classes of the errors."""


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """The names that an example can use: the runtime, and generated classes."""
    folder = tmp_path_factory.mktemp("examples")
    put({"demo_msgs/action/Fibonacci.action": ACTION}, folder)
    config = Config(folder, path=(folder,), package=PACKAGE, targets=("python",), bounds=Bounds({}, {}))
    put(
        pipeline.generate(config, TYPES),
        folder,
    )
    scope: dict[str, Any] = {"select": select}
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder / "python"))
        exec("from shmgen.runtime import *", scope)
        for module in ("geometry_msgs.msg", "std_srvs.srv", "demo_msgs.action"):
            exec(f"from {PACKAGE}.{module} import *", scope)
        yield scope
    forget(PACKAGE)


Names = dict[str, Any]


def publish(names: Names, space: str, ready: threading.Event, stop: threading.Event, depth: int = 1) -> None:
    with names["PosePublisher"](f"{space}/robot/pose", depth=depth) as publisher:
        ready.set()
        while not stop.wait(0.01):
            publisher.publish(names["Pose"](position=names["Point"](x=1.5)))


def publish_deep(names: Names, space: str, ready: threading.Event, stop: threading.Event) -> None:
    publish(names, space, ready, stop, depth=8)


def occupy(names: Names, space: str, ready: threading.Event, stop: threading.Event) -> None:
    """Publish another type on the topic of publish(), so that opening the topic raises an error."""
    with names["PointPublisher"](f"{space}/robot/pose"):
        ready.set()
        stop.wait()


def serve(names: Names, space: str, ready: threading.Event, stop: threading.Event) -> None:
    with names["SetBoolServer"](f"{space}/lamp") as server:
        ready.set()
        while not stop.is_set():
            server.serve(lambda request: names["SetBool_Response"](success=request.data), timeout=0.1)


def call(names: Names, space: str, ready: threading.Event, stop: threading.Event) -> None:
    with names["SetBoolClient"](f"{space}/lamp") as client:
        ready.set()
        while not stop.is_set():
            with suppress(runtime.CallTimeout, runtime.NoServer):
                names["print"](client.call(names["SetBool_Request"](data=True), timeout=1).success)


def execute(names: Names, space: str, ready: threading.Event, stop: threading.Event) -> None:
    with names["FibonacciActionServer"](f"{space}/fibonacci") as server:
        ready.set()
        while not stop.is_set():
            server.serve(lambda goal: goal.succeed(names["Fibonacci_Result"](sequence=[0, 1, 1])), timeout=0.1)


def send_goals(names: Names, space: str, ready: threading.Event, stop: threading.Event) -> None:
    with names["FibonacciActionClient"](f"{space}/fibonacci") as client:
        ready.set()
        while not stop.is_set():
            with suppress(runtime.CallTimeout, runtime.NoServer):
                client.send_goal(names["Fibonacci_Goal"](order=3), timeout=1)
                names["print"](list(client.result(timeout=1).result.sequence))


PEERS: dict[str, tuple[Callable[[Names, str, threading.Event, threading.Event], None] | None, str]] = {
    "ActionClient": (execute, "[0, 1, 1]"),
    "ActionServer": (send_goals, "[0, 1, 1]"),
    "Call": (call, "True"),
    "Duration": (None, "-0.5"),
    "Header": (publish, "geometry_msgs/msg/Pose"),
    "Message": (None, "True"),
    "Notifier": (publish, "x=1.5"),
    "Publisher": (None, ""),
    "RegionOptions": (None, ""),
    "Sample": (publish_deep, " 1.5"),
    "ServedGoal": (send_goals, "[0, 1, 1]"),
    "ServiceClient": (serve, "True"),
    "ServiceServer": (call, "True"),
    "ShmError": (occupy, "geometry_msgs/msg/Point"),
    "Subscriber": (publish, "1.5"),
    "Time": (None, "1700000000.5"),
    "ValueRejected": (None, "x 'far'"),
}
"""The peer that each example needs, and a text that the example or the peer prints."""


@pytest.mark.parametrize("name", CLASSES)
def test_docstring_example_of_a_class_works(name: str, names: Names, space: str) -> None:
    code = re.search(r"```python\n(.*?)```", inspect.getdoc(CLASSES[name]) or "", re.DOTALL)
    assert code, f"{name} has no example"
    example = re.sub(r"(?<!serve\(switch, )(?<!serve\(compute, )timeout=1.0", "timeout=60", code[1])
    example = example.replace('"/', f'"{space}/').replace("[], [], 1.0)", "[], [], 60)")
    peer, text = PEERS[name]
    printed: list[str] = []
    names = {**names, "print": lambda *values: printed.append(" ".join(map(str, values)))}
    ready, stop = threading.Event(), threading.Event()
    thread = threading.Thread(target=peer, args=(names, space, ready, stop)) if peer else None
    if thread:
        thread.start()
        assert ready.wait(60)
    try:
        end = time.monotonic() + 60
        exec(example, names)
        while not any(text in line for line in printed) and text and time.monotonic() < end:
            exec(example, names)  # repeat if a server ended before its client sent a request
    finally:
        stop.set()
        if thread:
            thread.join()
    assert not text or any(text in line for line in printed), printed
