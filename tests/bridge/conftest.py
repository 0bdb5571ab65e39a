"""A ROS 1 graph for each test that requests one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from ..support.ros1 import Graph


@pytest.fixture
def graph(tmp_path: Path, space: str) -> Iterator[Graph]:
    """A ROS graph. It ends before the regions of `space` are removed, because a running bridge would recreate them."""
    ros_graph = Graph(tmp_path)
    try:
        yield ros_graph
    finally:
        ros_graph.close()
