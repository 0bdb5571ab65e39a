"""The contract of backends, kept by all and by that of docs/adding-a-backend.md; and red for each that breaks it."""

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
HERE = {"PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY}"}


def with_rospy(folder: Path, number: int) -> Any:
    graph = ros1.Graph(folder)
    return graph, graph.start([graph.python, "-m", "tests.bridge.contract", "ros1"], HERE)


def with_rclpy(distribution: str) -> Callable[[Path, int], Any]:
    def start(folder: Path, number: int) -> Any:
        graph = ros2.Graph(folder, number, distribution)
        return graph, graph.start([graph.python, "-m", "tests.bridge.contract", "ros2"], HERE)

    return start


def with_cyclone(folder: Path, number: int) -> Any:
    if importlib.util.find_spec("cyclonedds") is None:
        pytest.skip("no cyclonedds here")
    domain = Domain(folder, number)
    return domain, domain.start([sys.executable, "-m", "tests.bridge.contract", "dds"])


def with_zenoh(folder: Path, number: int) -> Any:
    for package in ("zenoh", "xxhash"):
        pytest.importorskip(package, exc_type=Exception)
    graph = zenoh.Graph(folder, number)
    graph.router()
    return graph, graph.start([sys.executable, "-m", "tests.bridge.contract", "zenoh"])


def within_a_process(folder: Path, number: int) -> Any:
    """That of the page, in a copy of the repository."""
    pages.follow(PAGE, "memory_backend", pages.copy(folder))
    domain = Domain(folder, number)
    where = {"PYTHONPATH": f"{folder / 'src'}:{folder}"}
    return domain, domain.start([sys.executable, "-m", "tests.bridge.contract", "memory"], where)


BACKENDS: dict[str, Callable[[Path, int], Any]] = {
    "ros1": with_rospy,
    "ros2 jazzy": with_rclpy("jazzy"),
    "ros2 kilted": with_rclpy("kilted"),
    "dds": with_cyclone,
    "zenoh": with_zenoh,
    "memory": within_a_process,
}
"""What starts the checks of each in a graph; gives what to close, and the process."""


@pytest.fixture(scope="module", params=BACKENDS)
def outcome(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, testrun_uid: str, worker_id: str
) -> dict[str, str]:
    """Each check with what it said of the backend; nothing where the backend kept it."""
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
def test_it_is_kept(outcome: dict[str, str], check: Callable[[contract.Scene], None]) -> None:
    assert outcome.get(check.__name__, "it was never run") == ""


# --- backends that each break one thing ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def memory(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """The module of the page."""
    folder = pages.copy(tmp_path_factory.mktemp("memory"))
    file = pages.follow(PAGE, "memory_backend", folder)[-1]
    spec = importlib.util.spec_from_file_location("shmgen_memory_of_the_page", file)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def out_of_order(module: ModuleType, backend: Any) -> None:
    usual, held = backend.publisher, []

    def publisher(wire: Any) -> RosPublisher:
        outlet = usual(wire)

        def send(message: Any) -> None:
            held.append(message)
            if len(held) == 2:
                for one in reversed(held):
                    outlet.send(one)
                held.clear()

        return RosPublisher(outlet.new, send)

    backend.publisher = publisher


def slow(module: ModuleType, backend: Any) -> None:
    usual = backend.publisher

    def publisher(wire: Any) -> RosPublisher:
        outlet = usual(wire)
        return RosPublisher(outlet.new, lambda message: time.sleep(contract.AT_ONCE / 80) or outlet.send(message))

    backend.publisher = publisher


def without_latch(module: ModuleType, backend: Any) -> None:
    usual = backend.publisher
    backend.publisher = lambda wire: usual(contract.Wire(wire.name, wire.messages))


def latching_all(module: ModuleType, backend: Any) -> None:
    usual = backend.publisher
    backend.publisher = lambda wire: usual(contract.Wire(wire.name, wire.messages, latch=True))


def two_at_once(module: ModuleType, backend: Any) -> None:
    """Hands over in whatever thread sends."""

    def subscribe(wire: Any, sink: Any) -> Any:
        made = module.codec(wire.messages)

        class Direct:
            def put(self, data: bytes) -> None:
                module.threading.Thread(target=lambda: sink.take(made.decode(data)), daemon=True).start()

        module.TOPICS[wire.name].inlets.append(Direct())
        return RosSubscription(made.new)

    backend.subscribe = subscribe


def impatient(module: ModuleType, backend: Any) -> None:
    """A call without an answer raises what nobody expects."""
    usual = backend.client

    def client(wire: Any) -> Any:
        caller = usual(wire)

        def call(request: Any, timeout: float) -> Any:
            try:
                return caller.call(request, timeout)
            except contract.NoAnswer as error:
                raise TimeoutError(str(error)) from None

        return contract.RosClient(caller.new, call)

    backend.client = client


def patient(module: ModuleType, backend: Any) -> None:
    """A call waits as long as it likes."""
    usual = backend.client
    backend.client = lambda wire: contract.RosClient(
        usual(wire).new, lambda request, timeout: usual(wire).call(request, 20 * timeout)
    )


def silent(module: ModuleType, backend: Any) -> None:
    """Gives empty answers where there is none."""
    usual = backend.serve

    def serve(wire: Any, answer: Any, refuse: Any) -> None:
        def forgiving(request: Any, response: Any) -> None:
            with contextlib.suppress(contract.NoAnswer):
                answer(request, response)

        usual(wire, forgiving, refuse)

    backend.serve = serve


def lingering(module: ModuleType, backend: Any) -> None:
    backend.close = lambda: time.sleep(contract.AT_ONCE + 0.1)


def deaf(module: ModuleType, backend: Any) -> None:
    """Says that it has left, and goes on."""
    backend.close = lambda: None


def forgetting(module: ModuleType, backend: Any) -> None:
    """Actions whose goals are all accepted."""
    usual = backend.actions

    class Forgetting:
        action_client = staticmethod(usual.action_client)

        @staticmethod
        def serve(backend: Any, wire: Any, worker: Any, mishaps: Any) -> None:
            begin = worker.begin
            worker.begin = lambda goal: begin(goal) or True
            usual.serve(backend, wire, worker, mishaps)

    backend.actions = Forgetting


def hoarding(module: ModuleType, backend: Any) -> None:
    """Keeps a thread for each service that ever was."""
    usual = backend.serve

    def serve(wire: Any, answer: Any, refuse: Any) -> None:
        module.threading.Thread(target=lambda: time.sleep(4.0), daemon=True).start()
        usual(wire, answer, refuse)

    backend.serve = serve


def of_yesterday(module: ModuleType, backend: Any) -> None:
    backend.now = lambda: Time(0, 0)


BROKEN = {
    out_of_order: contract.what_is_sent_arrives_in_order,
    slow: contract.nobody_has_to_listen,
    without_latch: contract.what_is_latched_reaches_who_comes_late,
    latching_all: contract.what_is_latched_reaches_who_comes_late,
    two_at_once: contract.one_at_a_time_is_handed_over,
    impatient: contract.nobody_there_is_no_answer,
    patient: contract.an_answer_too_late_is_no_answer,
    silent: contract.an_answer_that_fails_is_no_answer,
    lingering: contract.it_leaves_at_once_and_for_good,
    deaf: contract.it_leaves_at_once_and_for_good,
    forgetting: contract.a_goal_that_is_not_accepted_is_none,
    hoarding: contract.what_is_undone_leaves_nothing_behind,
    of_yesterday: contract.it_is_alive_and_knows_the_time,
}


@pytest.mark.parametrize("fault", BROKEN, ids=lambda fault: fault.__name__)
@pytest.mark.family("[without_latch]", "[deaf]", "[forgetting]")
def test_a_broken_one_is_found(
    memory: ModuleType, fault: Callable[[ModuleType, Any], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contract, "LIMIT", 3.0)
    monkeypatch.setattr(contract, "AT_ONCE", 1.0)
    memory.TOPICS.clear()
    memory.SERVICES.clear()
    backend = memory.connect(Node("broken", None, lambda line: None, lambda: False))
    leave = backend.close
    fault(memory, backend)
    try:
        with pytest.raises((AssertionError, TimeoutError)):
            BROKEN[fault](contract.Scene(backend, "jazzy", []))
    finally:
        leave()


def test_the_bridge_takes_that_of_the_page(tmp_path: Path) -> None:
    """By its name, in a copy of the repository, until it is told to stop."""
    folder = pages.copy(tmp_path / "copy")
    pages.follow(PAGE, "memory_backend", folder)
    (tmp_path / "shmgen.toml").write_text('[[topics]]\ntopic = "/shmgen_test/page"\ntype = "std_msgs/Bool"\n')
    environment = {**os.environ, "PYTHONPATH": str(folder / "src"), "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, "-m", "shmgen", "bridge", "--backend", "memory"]
    try:
        with subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout
            found = any(line.startswith("running") for line in process.stdout)
            process.send_signal(signal.SIGINT)
            assert (found, process.wait(20)) == (True, 0)
    finally:
        for file in Path("/dev/shm").glob("*shmgen_test.page*"):
            file.unlink()
