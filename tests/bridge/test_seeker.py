"""Test that a goal for a ROS 2 action server waits until all endpoints of the server are discovered."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.bridge.backend import ActionWire, NoAnswer, RosClient, RosSubscription, ServiceWire, Wire
from shmgen.bridge.common.counters import Counters
from shmgen.bridge.ros2 import actions as ros2_actions
from shmgen.config import Config
from shmgen.generator import pipeline


class Backend:
    """A backend that has discovered all endpoints of the server except `missing`."""

    def __init__(self, missing: str) -> None:
        self.missing = missing
        self.called: list[str] = []

    def client(self, wire: ServiceWire) -> RosClient:
        def call(request: Any, timeout: float) -> Any:
            self.called.append(wire.name)
            return SimpleNamespace(accepted=False)

        return RosClient(
            lambda: SimpleNamespace(goal_id=SimpleNamespace(uuid=[0] * 16), goal=SimpleNamespace(order=0)),
            call,
            lambda: not wire.name.endswith(self.missing),
        )

    def subscribe(self, wire: Wire, take: Any, errors: Any) -> RosSubscription:
        return RosSubscription(lambda: None, lambda: not wire.name.endswith(self.missing))


@pytest.mark.parametrize("missing", ["send_goal", "get_result", "cancel_goal", "feedback", "nothing"])
def test_goal_waits_for_all_endpoints_of_the_server(missing: str, tmp_path: Path) -> None:
    file = tmp_path / "test_msgs" / "action" / "Fibonacci.action"
    file.parent.mkdir(parents=True)
    file.write_text("int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n")
    schema = pipeline.read(Config(tmp_path, path=(tmp_path,)), ["test_msgs/Fibonacci"])
    parts = {message.name.name: message for message in schema.messages}
    wire = ActionWire("/reach", *((parts[f"Fibonacci_{part}"],) for part in ("Goal", "Result", "Feedback")))
    backend: Any = Backend(missing)
    action_client = ros2_actions.action_client(backend, wire, Counters("/reach", print))
    follower: Any = None
    if missing == "nothing":
        assert action_client.send(lambda goal: None, 0.03, follower) is None
        assert backend.called == ["/reach/_action/send_goal"]
    else:
        with pytest.raises(NoAnswer, match=r"no server within 0\.03 s"):
            action_client.send(lambda goal: None, 0.03, follower)
        assert backend.called == []
