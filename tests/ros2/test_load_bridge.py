"""The load test of the bridge through rclpy, short, while calls wait for a PLC; `make load-bridge` is the long one."""

from __future__ import annotations

import pytest

from ..rigs.load_bridge import RATES, bridged
from ..support.ros2 import Graph

SECONDS = 3


@pytest.mark.slow
@pytest.mark.parametrize("graph", ["jazzy"], indirect=True)
def test_what_goes_through_the_bridge_comes_back_or_is_counted(graph: Graph, space: str) -> None:
    result = bridged(graph, f"{space}/load", SECONDS, calls=True)
    assert result.run.sent == SECONDS * sum(RATES.values())
    assert result.lost == 0
