"""Test actionlib's actions of a real ROS 1 through the bridge, both ways. Python replaces the PLC at the regions."""

from __future__ import annotations

import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.bridge.plan import actions
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import call_class
from shmgen.live.session import Session
from shmgen.runtime import ActionClient, ActionServer, ServedGoal

from ..support.ros1 import Bridge, Graph

ACTIVE, PREEMPTED, SUCCEEDED, ABORTED, REJECTED = 1, 2, 3, 4, 5
"""The states of actionlib_msgs/GoalStatus. The PLC uses the states of action_msgs."""
PLC_SUCCEEDED, PLC_CANCELED, PLC_ABORTED = 4, 5, 6
TEST, MOVE = "actionlib/TestAction", "move_base_msgs/MoveBaseAction"
DEFINITIONS = {
    "actionlib/action/Test": "int32 goal\n---\nint32 result\n---\nint32 feedback\n",
    "move_base_msgs/action/MoveBase": "geometry_msgs/PoseStamped target_pose\n---\n---\n"
    "geometry_msgs/PoseStamped base_position\n",
}
CONFIG = """
source = "noetic"
path = ["msgs"]
[strings]
default = 16
[[actions]]
action = "{space}/reach"
type = "actionlib/Test"
[[actions]]
action = "{space}/drive"
type = "move_base_msgs/MoveBase"
[[actions]]
action = "{space}/of/ros"
type = "actionlib/Test"
server = "ros"
timeout = 3.0
"""
LIMIT = 20.0


class Cell:
    """The graph, the bridge, a peer, and the PLC's servers and clients."""

    def __init__(self, graph: Graph, space: str) -> None:
        if subprocess.run([graph.python, "-c", "import actionlib, move_base_msgs"], check=False).returncode:
            pytest.skip("no actionlib here")
        for name, text in DEFINITIONS.items():
            file = graph.folder / "msgs" / f"{name}.action"
            file.parent.mkdir(parents=True)
            file.write_text(text)
        self.graph, self.space = graph, space
        self.bridge: Bridge = graph.bridge(CONFIG.format(space=space))
        config = load(graph.folder / "shmgen.toml", "shmgen.toml", Report())
        self.routes = {route.entry.name.removeprefix(f"{space}/"): route for route in actions(Session(config))}
        self.peer = graph.peer()

    def ask(self, do: str, name: str, **more: Any) -> Any:
        return self.peer.ask(do=do, action=f"{self.space}/{name}", **more)

    @contextmanager
    def plc(self, name: str, handler: Callable[[ServedGoal[Any]], None]) -> Iterator[None]:
        stop = threading.Event()
        route = self.routes[name]

        def run() -> None:
            with call_class(ActionServer, route.kinds)(route.entry.name) as served:
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

    def client(self, name: str) -> Any:
        route = self.routes[name]
        return call_class(ActionClient, route.kinds)(route.entry.name)


def execute_goal(goal: ServedGoal[Any]) -> None:
    """Execute a goal like tests/bridge/peer.py. Reject a goal below 0."""
    if goal.request.goal < 0:
        goal.reject()
        return
    for number in range(goal.request.goal):
        if goal.is_cancel_requested:
            goal.canceled(SimpleNamespace(result=-number))
            return
        goal.publish_feedback(SimpleNamespace(feedback=number))
        time.sleep(0.02)
    (goal.abort if goal.request.goal == 13 else goal.succeed)(SimpleNamespace(result=goal.request.goal))


def until(condition: Callable[[], Any], event: str) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, f"{event} did not come"
        time.sleep(0.01)


@pytest.fixture
def cell(graph: Graph, space: str) -> Cell:
    return Cell(graph, space)


def test_plc_serves_goals_of_a_ros_client(cell: Cell) -> None:
    def send_goal(order: int) -> Any:
        assert cell.ask("seek", "reach", type=TEST, goal={"goal": order}) is True
        return cell.ask("outcome", "reach")

    with cell.plc("reach", execute_goal):
        status, result, feedback = send_goal(9)
        assert (status, result) == (SUCCEEDED, {"result": 9})
        assert [item["feedback"] for item in feedback] == sorted({item["feedback"] for item in feedback})
        assert len(feedback) >= 5
        assert send_goal(-1)[0] == REJECTED
        assert send_goal(13)[:2] == [ABORTED, {"result": 13}]
        assert cell.ask("seek", "reach", type=TEST, goal={"goal": 10**6}) is True
        until(lambda: cell.ask("state", "reach") == ACTIVE, "its begin")
        cell.ask("cancel", "reach")
        status, result, _ = cell.ask("outcome", "reach")
        assert status == PREEMPTED
        assert result["result"] <= 0
        assert cell.ask("seek", "reach", type=TEST, goal={"goal": 10**6}) is True
        until(lambda: cell.ask("state", "reach") == ACTIVE, "its begin")
        cell.bridge.stop(signal.SIGTERM)
        assert cell.ask("outcome", "reach")[0] == ABORTED
    cell.bridge.wait_for_line("/reach +3 passed, 2 failed$")
    assert not [line for line in cell.bridge.lines if "Traceback" in line or "Error" in line]


def test_goal_with_nested_messages_passes(cell: Cell) -> None:
    """Send a goal with actionlib's generated classes, which requires equal md5 sums."""
    goal = {"target_pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}}}}
    assert cell.ask("seek", "drive", type=MOVE, goal=goal) is True
    assert cell.ask("outcome", "drive")[0] == REJECTED
    cell.bridge.wait_for_line("/drive: .*no server within 1 s")

    def drive(goal: ServedGoal[Any]) -> None:
        goal.publish_feedback(SimpleNamespace(base_position=goal.request.target_pose))
        time.sleep(0.2)  # feedback and result are topics, and actionlib ignores feedback after the result
        goal.succeed(SimpleNamespace())

    with cell.plc("drive", drive):
        assert cell.ask("seek", "drive", type=MOVE, goal=goal) is True
        status, _, feedback = cell.ask("outcome", "drive")
        assert status == SUCCEEDED
        (received,) = (item["base_position"] for item in feedback)
        assert (received["header"]["frame_id"], received["pose"]["position"]["x"]) == ("map", 1.5)


def test_ros_serves_goals_of_a_plc_client(cell: Cell) -> None:
    with cell.client("of/ros") as plc:
        plc.send_goal(SimpleNamespace(goal=5), 5)
        assert plc.result(LIMIT).status == PLC_ABORTED
        cell.bridge.wait_for_line("no server within 3 s")
        cell.ask("act", "of/ros", type=TEST)
        plc.send_goal(SimpleNamespace(goal=9), 5)
        received = []
        while (outcome := plc.poll()) is None:
            if feedback := plc.feedback():
                received.append(feedback.feedback)
            time.sleep(0.001)
        assert (outcome.status, outcome.result.result) == (PLC_SUCCEEDED, 9)
        assert received == sorted(set(received))
        assert len(received) >= 5
        plc.send_goal(SimpleNamespace(goal=13), 5)
        assert plc.result(LIMIT).status == PLC_ABORTED
        plc.send_goal(SimpleNamespace(goal=10**6), 5)
        until(plc.feedback, "feedback")
        plc.cancel()
        outcome = plc.result(LIMIT)
        assert outcome.status == PLC_CANCELED
        assert outcome.result.result <= 0
        plc.send_goal(SimpleNamespace(goal=10**6), 5)
        until(plc.feedback, "feedback")
        cell.peer.process.kill()
        assert plc.result(LIMIT).status == PLC_ABORTED
    cell.bridge.stop(signal.SIGTERM)
    cell.bridge.wait_for_line("/of/ros +3 passed, 2 failed$")
    assert not [line for line in cell.bridge.lines if "Traceback" in line or "Error" in line]
