"""Actions through `shmgen bridge`, between real rclpy nodes and a PLC that Python plays, both ways."""

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
from shmgen.live.classes import action_client, action_server, subscriber
from shmgen.runtime import ServedGoal

from ..conftest import REPOSITORY
from ..support.dds import without_fast_dds
from ..support.ros1 import PROMPTLY, Bridge
from ..support.ros2 import Graph, Peer
from .test_bridge import WAYS, all_ways, session

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
    """The bridge, a peer, and the PLC's ends of the actions."""

    def __init__(self, graph: Graph, space: str) -> None:
        self.graph = graph
        self.reach, self.of_ros = f"{space}/reach", f"{space}/of/ros"
        self.bridge: Bridge = graph.bridge(CONFIG.format(space=space))
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("AMENT_PREFIX_PATH", str(graph.prefix))
            patch.setenv("ROS_VERSION", "2")
            self.routes: dict[str, CallRoute] = {route.entry.name: route for route in actions(session(graph))}
        self.peer: Peer = graph.peer()

    def seek(self, order: int) -> Any:
        """Whether ROS's goal was accepted."""
        return self.peer.ask(do="seek", action=self.reach, type=FIBONACCI, goal={"order": order})

    def outcome(self) -> Any:
        return self.peer.ask(do="outcome", action=self.reach)

    @contextmanager
    def plc(self, handler: Callable[[ServedGoal[Any]], None]) -> Iterator[None]:
        """A PLC that serves the one."""
        made = action_server(self.routes[self.reach].kinds)
        ended = threading.Event()

        def run() -> None:
            with made(self.reach) as served:
                while not ended.is_set():
                    if goal := served.wait(0.05):
                        handler(goal)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join(5)

    def client(self) -> Any:
        """A PLC that seeks the other."""
        return action_client(self.routes[self.of_ros].kinds)(self.of_ros)


def wait(condition: Any, what: str) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not come"
        time.sleep(0.002)


def sequence(*numbers: int) -> Any:
    return SimpleNamespace(sequence=list(numbers))


def count_up(goal: ServedGoal[Any]) -> None:
    """What the peer does as well."""
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


some_ways = pytest.mark.parametrize(
    "graph",
    [*WAYS[:3], pytest.param(WAYS[3], marks=pytest.mark.slow)],
    indirect=True,
    ids=["-".join(way) for way in WAYS],
)


@all_ways
def test_ros_seeks_and_the_plc_acts(cell: Cell) -> None:
    with cell.plc(count_up):
        assert cell.seek(5) is True
        status, result, feedback = cell.outcome()
        assert (status, result) == (SUCCEEDED, {"sequence": [0, 1, 2, 3, 4]})
        assert feedback[-1] == {"sequence": [0, 1, 2, 3, 4]}
        assert cell.seek(-1) is False
        assert cell.seek(13) is True
        status, result, feedback = cell.outcome()
        assert (status, result) == (ABORTED, {"sequence": list(range(8))})
        assert 8 <= len(feedback) <= 13
        assert cell.seek(10**6) is True
        assert cell.peer.ask(do="cancel", action=cell.reach) == 1
        status, result, _ = cell.outcome()
        assert status == CANCELED
        assert result["sequence"][0] <= 0

        # A newer goal ends the one before.
        assert cell.seek(10**6) is True
        other = cell.graph.peer()
        assert other.ask(do="seek", action=cell.reach, type=FIBONACCI, goal={"order": 3}) is True
        assert cell.outcome()[0] == ABORTED
        assert other.ask(do="outcome", action=cell.reach)[:2] == [SUCCEEDED, {"sequence": [0, 1, 2]}]

        # The bridge ends, and with it the goal.
        assert cell.seek(10**6) is True
        ends: list[Any] = []
        waiting = threading.Thread(target=lambda: ends.append(cell.outcome()[0]))
        waiting.start()
        time.sleep(0.3)  # its question is on the way
        assert cell.bridge.stop(signal.SIGTERM) < PROMPTLY
        waiting.join()
        assert ends == [ABORTED]
    cell.bridge.wait_for_line("/reach +4 passed, 3 failed$")
    assert not [line for line in cell.bridge.lines if "Traceback" in line or "Error" in line]


TAKES_ONE = """
import sys, time
from shmgen.bridge.plan import actions
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import action_server
from shmgen.live.session import Session
route = actions(Session(load(__import__("pathlib").Path("shmgen.toml"), "shmgen.toml", Report())))[0]
with action_server(route.kinds)(route.entry.name) as served:
    print("serves", flush=True)
    served.wait(60).accept()
    print("taken", flush=True)
    time.sleep(60)
"""


@some_ways
def test_a_plc_that_is_not_there_says_nothing_or_is_killed(cell: Cell) -> None:
    assert cell.seek(5) is False
    cell.bridge.wait_for_line("no server within 1 s; the request was not sent")
    seen: list[ServedGoal[Any]] = []

    def say_nothing(goal: ServedGoal[Any]) -> None:
        seen.append(goal)
        wait(lambda: goal.is_cancel_requested, "its cancel")

    with cell.plc(say_nothing):
        assert cell.seek(5) is False
        wait(lambda: seen, "the goal")
    plc = cell.graph.start([cell.graph.python, "-c", TAKES_ONE], {"PYTHONPATH": str(REPOSITORY / "src")})
    assert plc.stdout.readline() == "serves\n"
    assert cell.seek(5) is True
    assert plc.stdout.readline() == "taken\n"
    plc.kill()
    assert cell.outcome()[0] == ABORTED
    cell.bridge.stop(signal.SIGTERM)
    cell.bridge.wait_for_line("/reach +0 passed, 3 failed$")


@some_ways
def test_what_a_killed_bridge_or_plc_leaves_is_cancelled(cell: Cell) -> None:
    """By the next bridge, which knows nothing of the goal; and a goal of ROS whose PLC is gone, by this one."""
    with cell.plc(count_up):
        assert cell.seek(10**6) is True
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
        wait(plc.feedback, "feedback")
    wait(lambda: cell.peer.ask(do="canceled"), "the end of ROS's goal")


@all_ways
def test_the_plc_seeks_and_ros_acts(cell: Cell) -> None:
    with cell.client() as plc:
        plc.send_goal(SimpleNamespace(order=5), 5)
        assert plc.result(LIMIT).status == ABORTED  # there is no server
        cell.bridge.wait_for_line("no server within 6 s")
        cell.peer.ask(do="act", action=cell.of_ros, type=FIBONACCI)
        plc.send_goal(SimpleNamespace(order=5), 5)
        seen = []
        while (outcome := plc.poll()) is None:
            if feedback := plc.feedback():
                seen.append(list(feedback.sequence))
            time.sleep(0.001)
        assert (outcome.status, list(outcome.result.sequence)) == (SUCCEEDED, [0, 1, 2, 3, 4])
        assert seen
        assert all(numbers == list(range(len(numbers))) for numbers in seen)  # of a region there is the newest only
        for order, status in ((-1, REJECTED), (13, ABORTED), (20, ABORTED)):  # 20 do not fit
            plc.send_goal(SimpleNamespace(order=order), 5)
            assert plc.result(LIMIT).status == status, order
        plc.send_goal(SimpleNamespace(order=10**6), 5)
        wait(plc.feedback, "feedback")
        plc.cancel()
        outcome = plc.result(LIMIT)
        assert outcome.status == CANCELED
        assert outcome.result.sequence[0] <= 0
        plc.send_goal(SimpleNamespace(order=10**6), 5)
        wait(lambda: plc.status, "its begin")
        plc.send_goal(SimpleNamespace(order=2), 5)
        assert list(plc.result(LIMIT).result.sequence) == [0, 1]
        plc.send_goal(SimpleNamespace(order=10**6), 5)
        wait(lambda: plc.status, "its begin")
        assert cell.bridge.stop(signal.SIGTERM) < PROMPTLY
        assert plc.result(LIMIT).status == ABORTED
    assert not [line for line in cell.bridge.lines if "Traceback" in line or "Error" in line]


PROFILE = """<?xml version="1.0"?><profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
<participant profile_name="short" is_default_profile="true"><rtps><builtin><discovery_config>
<leaseDuration><sec>2</sec></leaseDuration><leaseAnnouncement><sec>0</sec><nanosec>500000000</nanosec></leaseAnnouncement>
</discovery_config></builtin></rtps></participant></profiles>"""


@some_ways
def test_a_killed_server_of_ros_ends_in_an_aborted_goal(cell: Cell, tmp_path: Path) -> None:
    """As soon as DDS takes it for gone: 2 s here, 20 s as Fast DDS has it."""
    (tmp_path / "short.xml").write_text(PROFILE)
    names = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
    server = cell.graph.peer(dict.fromkeys(names, str(tmp_path / "short.xml")))
    server.ask(do="act", action=cell.of_ros, type=FIBONACCI)
    with cell.client() as plc:
        plc.send_goal(SimpleNamespace(order=10**6), 5)
        wait(plc.feedback, "feedback")
        server.process.kill()
        assert plc.result(LIMIT).status == ABORTED
    cell.bridge.wait_for_line("/of/ros: goal aborted: the server has left")
