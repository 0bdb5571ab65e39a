"""Test actions through `shmgen bridge` between rclpy nodes and a PLC that Python replaces, both ways."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.bridge.plan import CallRoute, actions
from shmgen.live.classes import call_class, subscriber
from shmgen.runtime import ActionClient, ActionServer, ServedGoal

from ..conftest import REPOSITORY
from ..support.dds import without_fast_dds
from ..support.ros1 import PROMPTLY, Bridge
from ..support.ros2 import Graph, Peer
from .test_bridge import BACKENDS, all_backends, session

SUCCEEDED, CANCELED, ABORTED, REJECTED = 4, 5, 6, -1
FIBONACCI = "test_msgs/action/Fibonacci"
LIMIT = 20.0
CONFIG = """
source = "env"
[bounds]
test_msgs = 8
[[actions]]
action = "{space}/reach"
type = "test_msgs/Fibonacci"
[[actions]]
action = "{space}/of/ros"
type = "test_msgs/Fibonacci"
server = "ros"
timeout = 6.0
"""


class Cell:
    """The bridge, a peer, and the PLC's server and client."""

    def __init__(self, graph: Graph, space: str) -> None:
        self.graph = graph
        self.reach, self.of_ros = f"{space}/reach", f"{space}/of/ros"
        self.bridge: Bridge = graph.bridge(CONFIG.format(space=space))
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("AMENT_PREFIX_PATH", str(graph.prefix))
            patch.setenv("ROS_VERSION", "2")
            self.routes: dict[str, CallRoute] = {route.entry.name: route for route in actions(session(graph))}
        self.peer: Peer = graph.peer()

    def send_goal(self, order: int) -> Any:
        """Send a goal from ROS, and return True if it was accepted."""
        return self.peer.ask(do="seek", action=self.reach, type=FIBONACCI, goal={"order": order})

    def outcome(self) -> Any:
        return self.peer.ask(do="outcome", action=self.reach)

    @contextmanager
    def plc(self, handler: Callable[[ServedGoal[Any]], None]) -> Iterator[None]:
        """Run a PLC that serves the action `reach`."""
        server_class = call_class(ActionServer, self.routes[self.reach].kinds)
        stop = threading.Event()

        def run() -> None:
            with server_class(self.reach) as served:
                while not stop.is_set():
                    if goal := served.wait(0.05):
                        handler(goal)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join(5)

    def client(self) -> Any:
        """Return a PLC client of the action that ROS serves."""
        return call_class(ActionClient, self.routes[self.of_ros].kinds)(self.of_ros)


def wait_until(condition: Any, event: str) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, f"{event} did not come"
        time.sleep(0.002)


def sequence(*numbers: int) -> Any:
    return SimpleNamespace(sequence=list(numbers))


def execute_goal(goal: ServedGoal[Any]) -> None:
    """Execute a goal like tests/ros2/peer.py."""
    order = goal.request.order
    if order < 0:
        goal.reject()
        return
    for number in range(order):
        if goal.is_cancel_requested:
            goal.canceled(sequence(-number))
            return
        goal.publish_feedback(sequence(*range(number % 8 + 1)))
        time.sleep(0.02)
    (goal.abort if order == 13 else goal.succeed)(sequence(*range(min(order, 8))))


@pytest.fixture
def cell(graph: Graph, space: str) -> Cell:
    if graph.backend == "dds":
        without_fast_dds()
    return Cell(graph, space)


most_backends = pytest.mark.parametrize(
    "graph",
    [*BACKENDS[:3], pytest.param(BACKENDS[3], marks=pytest.mark.slow)],
    indirect=True,
    ids=["-".join(backend) for backend in BACKENDS],
)


@all_backends
def test_plc_serves_goals_of_a_ros_client(cell: Cell) -> None:
    with cell.plc(execute_goal):
        assert cell.send_goal(5) is True
        status, result, feedback = cell.outcome()
        assert (status, result) == (SUCCEEDED, {"sequence": [0, 1, 2, 3, 4]})
        assert feedback[-1] == {"sequence": [0, 1, 2, 3, 4]}
        assert cell.send_goal(-1) is False
        assert cell.send_goal(13) is True
        status, result, feedback = cell.outcome()
        assert (status, result) == (ABORTED, {"sequence": list(range(8))})
        assert 8 <= len(feedback) <= 13
        assert cell.send_goal(10**6) is True
        assert cell.peer.ask(do="cancel", action=cell.reach) == 1
        status, result, _ = cell.outcome()
        assert status == CANCELED
        assert result["sequence"][0] <= 0

        # A newer goal aborts the previous goal.
        assert cell.send_goal(10**6) is True
        other = cell.graph.peer()
        assert other.ask(do="seek", action=cell.reach, type=FIBONACCI, goal={"order": 3}) is True
        assert cell.outcome()[0] == ABORTED
        assert other.ask(do="outcome", action=cell.reach)[:2] == [SUCCEEDED, {"sequence": [0, 1, 2]}]

        # The stop of the bridge aborts the goal.
        assert cell.send_goal(10**6) is True
        statuses: list[Any] = []
        thread = threading.Thread(target=lambda: statuses.append(cell.outcome()[0]))
        thread.start()
        time.sleep(0.3)  # until the request for the result has been sent
        assert cell.bridge.stop(signal.SIGTERM) < PROMPTLY
        thread.join()
        assert statuses == [ABORTED]
    cell.bridge.wait_for_line("/reach +4 passed, 3 failed$")
    assert not [line for line in cell.bridge.lines if "Traceback" in line or "Error" in line]


SERVER_PROGRAM = """
import sys, time
from shmgen.bridge.plan import actions
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import call_class
from shmgen.live.session import Session
from shmgen.runtime import ActionServer
route = actions(Session(load(__import__("pathlib").Path("shmgen.toml"), "shmgen.toml", Report())))[0]
with call_class(ActionServer, route.kinds)(route.entry.name) as served:
    print("serves", flush=True)
    served.wait(60).accept()
    print("taken", flush=True)
    time.sleep(60)
"""


@most_backends
def test_goal_fails_if_the_plc_is_off_silent_or_killed(cell: Cell) -> None:
    assert cell.send_goal(5) is False
    cell.bridge.wait_for_line("no server within 1 s; the request was not sent")
    received: list[ServedGoal[Any]] = []

    def ignore_goal(goal: ServedGoal[Any]) -> None:
        received.append(goal)
        wait_until(lambda: goal.is_cancel_requested, "its cancel")

    with cell.plc(ignore_goal):
        assert cell.send_goal(5) is False
        wait_until(lambda: received, "the goal")
    plc = cell.graph.start([cell.graph.python, "-c", SERVER_PROGRAM], {"PYTHONPATH": str(REPOSITORY / "src")})
    assert plc.stdout.readline() == "serves\n"
    assert cell.send_goal(5) is True
    assert plc.stdout.readline() == "taken\n"
    plc.kill()
    assert cell.outcome()[0] == ABORTED
    cell.bridge.stop(signal.SIGTERM)
    cell.bridge.wait_for_line("/reach +0 passed, 3 failed$")


@most_backends
def test_goals_of_a_killed_bridge_or_plc_are_canceled(cell: Cell) -> None:
    """Cancel the goal of a killed bridge in the next bridge, and cancel a goal in ROS whose PLC client has closed."""
    with cell.plc(execute_goal):
        assert cell.send_goal(10**6) is True
        cell.bridge.kill()
        kinds = cell.routes[cell.reach].kinds
        with (
            subscriber(kinds["_Progress"], f"{cell.reach}-feedback", 1) as progress,
            subscriber(kinds["_Outcome"], f"{cell.reach}-result", 1) as outcomes,
        ):
            goal = progress.wait(LIMIT).goal
            cell.bridge = cell.graph.bridge()
            assert (outcome := outcomes.wait(LIMIT)) is not None
            assert (outcome.goal, outcome.status) == (goal, CANCELED)
    cell.peer.ask(do="act", action=cell.of_ros, type=FIBONACCI)
    with cell.client() as plc:
        plc.send_goal(SimpleNamespace(order=10**6), 5)
        wait_until(plc.feedback, "feedback")
    wait_until(lambda: cell.peer.ask(do="canceled"), "the end of ROS's goal")


@all_backends
def test_ros_serves_goals_of_a_plc_client(cell: Cell) -> None:
    with cell.client() as plc:
        plc.send_goal(SimpleNamespace(order=5), 5)
        assert plc.result(LIMIT).status == ABORTED  # ROS has no server yet
        cell.bridge.wait_for_line("no server within 6 s")
        cell.peer.ask(do="act", action=cell.of_ros, type=FIBONACCI)
        plc.send_goal(SimpleNamespace(order=5), 5)
        received = []
        while (outcome := plc.poll()) is None:
            if feedback := plc.feedback():
                received.append(list(feedback.sequence))
            time.sleep(0.001)
        assert (outcome.status, list(outcome.result.sequence)) == (SUCCEEDED, [0, 1, 2, 3, 4])
        assert received
        assert all(numbers == list(range(len(numbers))) for numbers in received)  # older feedback is overwritten
        for order, status in ((-1, REJECTED), (13, ABORTED), (20, ABORTED)):  # 20 exceeds the bound
            plc.send_goal(SimpleNamespace(order=order), 5)
            assert plc.result(LIMIT).status == status, order
        plc.send_goal(SimpleNamespace(order=10**6), 5)
        wait_until(plc.feedback, "feedback")
        plc.cancel()
        outcome = plc.result(LIMIT)
        assert outcome.status == CANCELED
        assert outcome.result.sequence[0] <= 0
        plc.send_goal(SimpleNamespace(order=10**6), 5)
        wait_until(lambda: plc.status, "its begin")
        plc.send_goal(SimpleNamespace(order=2), 5)
        assert list(plc.result(LIMIT).result.sequence) == [0, 1]
        plc.send_goal(SimpleNamespace(order=10**6), 5)
        wait_until(lambda: plc.status, "its begin")
        assert cell.bridge.stop(signal.SIGTERM) < PROMPTLY
        assert plc.result(LIMIT).status == ABORTED
    assert not [line for line in cell.bridge.lines if "Traceback" in line or "Error" in line]


PROFILE = """<?xml version="1.0"?><profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
<participant profile_name="short" is_default_profile="true"><rtps><builtin><discovery_config>
<leaseDuration><sec>2</sec></leaseDuration><leaseAnnouncement><sec>0</sec><nanosec>500000000</nanosec></leaseAnnouncement>
</discovery_config></builtin></rtps></participant></profiles>"""


@most_backends
def test_goal_is_aborted_if_its_ros_server_is_killed(cell: Cell, tmp_path: Path) -> None:
    """End the goal when the DDS lease of the server ends: after 2 s in this test, after 20 s by Fast DDS's default."""
    (tmp_path / "short.xml").write_text(PROFILE)
    names = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
    server = cell.graph.peer(dict.fromkeys(names, str(tmp_path / "short.xml")))
    server.ask(do="act", action=cell.of_ros, type=FIBONACCI)
    with cell.client() as plc:
        plc.send_goal(SimpleNamespace(order=10**6), 5)
        wait_until(plc.feedback, "feedback")
        server.process.kill()
        assert plc.result(LIMIT).status == ABORTED
    cell.bridge.wait_for_line("/of/ros: goal aborted: the server has left")
