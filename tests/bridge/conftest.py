"""A ROS 1 graph for each test that wants one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from ..support.ros1 import Graph


@pytest.fixture
def graph(tmp_path: Path, space: str) -> Iterator[Graph]:
    """Ends before the regions of `space` go: a bridge makes them anew."""
    made = Graph(tmp_path)
    try:
        yield made
    finally:
        made.close()
