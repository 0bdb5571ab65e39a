"""Run the load test of `make load-bridge` through rclpy for a few seconds, while calls wait for a PLC."""

from __future__ import annotations

import pytest

from ..rigs.load_bridge import RATES, bridged
from ..support.ros2 import Graph

SECONDS = 3


@pytest.mark.slow
@pytest.mark.parametrize("graph", ["jazzy"], indirect=True)
def test_short_load_run_counts_every_lost_message(graph: Graph, space: str) -> None:
    result = bridged(graph, f"{space}/load", SECONDS, calls=True)
    assert result.run.sent == SECONDS * sum(RATES.values())
    assert result.lost == 0
