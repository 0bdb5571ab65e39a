"""Run the load test of `make load-bridge` for a few seconds."""

from __future__ import annotations

import pytest

from ..rigs.load_bridge import RATES, bridged
from ..support.ros1 import Graph

SECONDS = 3


@pytest.mark.slow
def test_short_load_run_counts_every_lost_message(graph: Graph, space: str) -> None:
    result = bridged(graph, f"{space}/load", SECONDS)
    assert result.run.sent == SECONDS * sum(RATES.values())
    assert result.lost == 0
