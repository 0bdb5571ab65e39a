"""Test that all backends and that of docs/adding-a-backend.md keep the contract, and that broken backends fail it."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from shmgen.bridge.backend import Node, RosPublisher, RosSubscription
from shmgen.runtime import Time

from ..conftest import REPOSITORY
from ..support import pages, ros1, ros2, zenoh
from ..support.dds import Domain
from . import contract

PAGE = REPOSITORY / "docs" / "adding-a-backend.md"
ENVIRONMENT = {"PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY}"}


def start_ros1(folder: Path, number: int) -> Any:
    graph = ros1.Graph(folder)
    return graph, graph.start([graph.python, "-m", "tests.bridge.contract", "ros1"], ENVIRONMENT)


def start_ros2(distribution: str) -> Callable[[Path, int], Any]:
    def start(folder: Path, number: int) -> Any:
        graph = ros2.Graph(folder, number, distribution)
        return graph, graph.start([graph.python, "-m", "tests.bridge.contract", "ros2"], ENVIRONMENT)

    return start


def start_dds(folder: Path, number: int) -> Any:
    if importlib.util.find_spec("cyclonedds") is None:
        pytest.skip("no cyclonedds here")
    domain = Domain(folder, number)
    return domain, domain.start([sys.executable, "-m", "tests.bridge.contract", "dds"])


def start_zenoh(folder: Path, number: int) -> Any:
    for package in ("zenoh", "xxhash"):
        pytest.importorskip(package, exc_type=Exception)
    graph = zenoh.Graph(folder, number)
    graph.router()
    return graph, graph.start([sys.executable, "-m", "tests.bridge.contract", "zenoh"])


def start_example_backend(folder: Path, number: int) -> Any:
    """Start the contract's checks of the backend in docs/adding-a-backend.md, in a copy of the repository."""
    pages.follow(PAGE, "memory_backend", pages.copy(folder))
    domain = Domain(folder, number)
    environment = {"PYTHONPATH": f"{folder / 'src'}:{folder}"}
    return domain, domain.start([sys.executable, "-m", "tests.bridge.contract", "memory"], environment)


BACKENDS: dict[str, Callable[[Path, int], Any]] = {
    "ros1": start_ros1,
    "ros2 jazzy": start_ros2("jazzy"),
    "ros2 kilted": start_ros2("kilted"),
    "dds": start_dds,
    "zenoh": start_zenoh,
    "memory": start_example_backend,
}
"""Functions that start the checks of a backend. They return the graph to close, and the process."""


@pytest.fixture(scope="module", params=BACKENDS)
def outcome(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, testrun_uid: str, worker_id: str
) -> dict[str, str]:
    """The traceback of each check, or `""` if the backend passed."""
    number = 1 + (zlib.crc32(testrun_uid.encode()) + zlib.crc32(worker_id.encode()) + 25) % 100
    graph, process = BACKENDS[request.param](tmp_path_factory.mktemp("contract"), number)
    try:
        printed, _ = process.communicate(timeout=180)
    finally:
        graph.close()
    lines = [json.loads(line) for line in printed.splitlines() if line.startswith('{"check"')]
    return {line["check"]: line["failed"] for line in lines}


@pytest.mark.parametrize("check", contract.CHECKS, ids=lambda check: check.__name__)
@pytest.mark.family("[memory-")
def test_backend_keeps_the_contract(outcome: dict[str, str], check: Callable[[contract.Scene], None]) -> None:
    assert outcome.get(check.__name__, "the check did not run") == ""


# --- backends that each break one rule -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def memory(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """The module of the backend in docs/adding-a-backend.md."""
    folder = pages.copy(tmp_path_factory.mktemp("memory"))
    file = pages.follow(PAGE, "memory_backend", folder)[-1]
    spec = importlib.util.spec_from_file_location("shmgen_memory_of_the_page", file)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def reorder_messages(module: ModuleType, backend: Any) -> None:
    original, pending = backend.publisher, []

    def publisher(wire: Any) -> RosPublisher:
        outlet = original(wire)

        def send(message: Any) -> None:
            pending.append(message)
            if len(pending) == 2:
                for held_message in reversed(pending):
                    outlet.send(held_message)
                pending.clear()

        return RosPublisher(outlet.new, send)

    backend.publisher = publisher


def send_slowly(module: ModuleType, backend: Any) -> None:
    original = backend.publisher

    def publisher(wire: Any) -> RosPublisher:
        outlet = original(wire)
        return RosPublisher(outlet.new, lambda message: time.sleep(contract.AT_ONCE / 80) or outlet.send(message))

    backend.publisher = publisher


def ignore_latch(module: ModuleType, backend: Any) -> None:
    original = backend.publisher
    backend.publisher = lambda wire: original(contract.Wire(wire.name, wire.messages))


def latch_all_topics(module: ModuleType, backend: Any) -> None:
    original = backend.publisher
    backend.publisher = lambda wire: original(contract.Wire(wire.name, wire.messages, latch=True))


def deliver_concurrently(module: ModuleType, backend: Any) -> None:
    """Deliver each message in a new thread."""

    def subscribe(wire: Any, take: Any, errors: Any) -> Any:
        message_codec = module.codec(wire.messages)

        class Direct:
            def put(self, data: bytes) -> None:
                module.threading.Thread(target=lambda: take(message_codec.decode(data)), daemon=True).start()

        module.TOPICS[wire.name].inlets.append(Direct())
        return RosSubscription(message_codec.new)

    backend.subscribe = subscribe


def raise_timeout_error(module: ModuleType, backend: Any) -> None:
    """Raise TimeoutError instead of NoAnswer."""
    original = backend.client

    def client(wire: Any) -> Any:
        caller = original(wire)

        def call(request: Any, timeout: float) -> Any:
            try:
                return caller.call(request, timeout)
            except contract.NoAnswer as error:
                raise TimeoutError(str(error)) from None

        return contract.RosClient(caller.new, call)

    backend.client = client


def wait_too_long(module: ModuleType, backend: Any) -> None:
    """Wait 20 times as long as the timeout of a call."""
    original = backend.client
    backend.client = lambda wire: contract.RosClient(
        original(wire).new, lambda request, timeout: original(wire).call(request, 20 * timeout)
    )


def reply_to_failed_calls(module: ModuleType, backend: Any) -> None:
    """Send an empty reply if a call fails."""
    original = backend.serve

    def serve(wire: Any, answer: Any, errors: Any) -> None:
        def answer_or_ignore(request: Any, response: Any) -> None:
            with contextlib.suppress(contract.NoAnswer):
                answer(request, response)

        original(wire, answer_or_ignore, errors)

    backend.serve = serve


def close_slowly(module: ModuleType, backend: Any) -> None:
    backend.close = lambda: time.sleep(contract.AT_ONCE + 0.1)


def ignore_close(module: ModuleType, backend: Any) -> None:
    """Ignore close()."""
    backend.close = lambda: None


def accept_every_goal(module: ModuleType, backend: Any) -> None:
    """Accept every goal, also if the worker rejects it."""
    original = backend.actions

    class AcceptingActions:
        action_client = staticmethod(original.action_client)

        @staticmethod
        def serve(backend: Any, wire: Any, worker: Any, errors: Any) -> None:
            begin = worker.begin
            worker.begin = lambda goal: begin(goal) or True
            original.serve(backend, wire, worker, errors)

    backend.actions = AcceptingActions


def leak_threads(module: ModuleType, backend: Any) -> None:
    """Start a thread for each service and leave it running."""
    original = backend.serve

    def serve(wire: Any, answer: Any, errors: Any) -> None:
        module.threading.Thread(target=lambda: time.sleep(4.0), daemon=True).start()
        original(wire, answer, errors)

    backend.serve = serve


def report_time_zero(module: ModuleType, backend: Any) -> None:
    backend.now = lambda: Time(0, 0)


BROKEN = {
    reorder_messages: contract.messages_arrive_in_order,
    send_slowly: contract.sending_needs_no_subscriber,
    ignore_latch: contract.latched_message_reaches_late_subscriber,
    latch_all_topics: contract.latched_message_reaches_late_subscriber,
    deliver_concurrently: contract.messages_are_delivered_one_at_a_time,
    raise_timeout_error: contract.call_without_server_raises_no_answer,
    wait_too_long: contract.late_reply_raises_no_answer,
    reply_to_failed_calls: contract.failed_call_raises_no_answer,
    close_slowly: contract.close_is_prompt_and_final,
    ignore_close: contract.close_is_prompt_and_final,
    accept_every_goal: contract.rejected_goal_returns_none,
    leak_threads: contract.undo_leaves_no_threads_or_descriptors,
    report_time_zero: contract.backend_is_alive_and_has_the_time,
}


@pytest.mark.parametrize("fault", BROKEN, ids=lambda fault: fault.__name__)
@pytest.mark.family("[ignore_latch]", "[ignore_close]", "[accept_every_goal]")
def test_contract_detects_a_broken_backend(
    memory: ModuleType, fault: Callable[[ModuleType, Any], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contract, "LIMIT", 3.0)
    monkeypatch.setattr(contract, "AT_ONCE", 1.0)
    memory.TOPICS.clear()
    memory.SERVICES.clear()
    backend = memory.connect(Node("broken", None, lambda line: None, lambda: False))
    close = backend.close
    fault(memory, backend)
    try:
        with pytest.raises((AssertionError, TimeoutError)):
            BROKEN[fault](contract.Scene(backend, "jazzy", []))
    finally:
        close()


def test_bridge_runs_the_backend_of_the_page(tmp_path: Path) -> None:
    """Start the bridge with that backend in a copy of the repository, and stop it by SIGINT."""
    folder = pages.copy(tmp_path / "copy")
    pages.follow(PAGE, "memory_backend", folder)
    (tmp_path / "shmgen.toml").write_text('[[topics]]\ntopic = "/shmgen_test/page"\ntype = "std_msgs/Bool"\n')
    environment = {**os.environ, "PYTHONPATH": str(folder / "src"), "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, "-m", "shmgen", "bridge", "--backend", "memory"]
    try:
        with subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout
            is_running = any(line.startswith("running") for line in process.stdout)
            process.send_signal(signal.SIGINT)
            assert (is_running, process.wait(20)) == (True, 0)
    finally:
        for file in Path("/dev/shm").glob("*shmgen_test.page*"):
            file.unlink()
