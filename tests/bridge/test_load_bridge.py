"""The load test of the bridge, short; `make load-bridge` is the long one."""

from __future__ import annotations

import pytest

from ..rigs.load_bridge import RATES, bridged
from ..support.ros1 import Graph

SECONDS = 3


@pytest.mark.slow
def test_what_goes_through_the_bridge_comes_back_or_is_counted(graph: Graph, space: str) -> None:
    result = bridged(graph, f"{space}/load", SECONDS)
    assert result.run.sent == SECONDS * sum(RATES.values())
    assert result.lost == 0
