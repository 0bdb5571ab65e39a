"""A goal for an action server of ROS 2 is sent when all ends of the server are known, and not before."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.bridge.backend import ActionWire, NoAnswer, RosClient, RosSubscription, ServiceWire, Wire
from shmgen.bridge.ros2 import actions as ros2_actions
from shmgen.config import Config
from shmgen.generator import pipeline


class Backend:
    """It knows of all ends of the server but the `missing` one."""

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

    def subscribe(self, wire: Wire, sink: Any) -> RosSubscription:
        return RosSubscription(lambda: None, lambda: not wire.name.endswith(self.missing))


@pytest.mark.parametrize("missing", ["send_goal", "get_result", "cancel_goal", "feedback", "nothing"])
def test_a_server_that_is_found_in_part(missing: str, tmp_path: Path) -> None:
    file = tmp_path / "test_msgs" / "action" / "Fibonacci.action"
    file.parent.mkdir(parents=True)
    file.write_text("int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n")
    schema = pipeline.read(Config(tmp_path, path=(tmp_path,)), ["test_msgs/Fibonacci"])
    parts = {message.name.name: message for message in schema.messages}
    wire = ActionWire("/reach", *((parts[f"Fibonacci_{part}"],) for part in ("Goal", "Result", "Feedback")))
    backend: Any = Backend(missing)
    seeker = ros2_actions.action_client(
        backend, wire, SimpleNamespace(reject=None, refuse=None, set_incompatible_peer=None, lose=None)
    )  # type: ignore[arg-type]
    follower: Any = None
    if missing == "nothing":
        assert seeker.send(lambda goal: None, 0.03, follower) is None
        assert backend.called == ["/reach/_action/send_goal"]
    else:
        with pytest.raises(NoAnswer, match=r"no server within 0\.03 s"):
            seeker.send(lambda goal: None, 0.03, follower)
        assert backend.called == []
