"""A ROS 2 domain with real rclpy for each test that requests one."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from ..support.ros2 import Graph


@pytest.fixture(scope="session")
def domain(testrun_uid: str, worker_id: str) -> int:
    """A domain number for each worker, from the numbers whose ports Linux assigns to no other socket."""
    number = int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0
    return 1 + (zlib.crc32(testrun_uid.encode()) + number + 50) % 100


@pytest.fixture(params=["jazzy", "kilted"])
def graph(request: pytest.FixtureRequest, tmp_path: Path, domain: int, space: str) -> Iterator[Graph]:
    """A ROS graph. It ends before the regions of `space` are removed, because a running bridge would recreate them."""
    ros_graph = Graph(tmp_path, domain, *(request.param if isinstance(request.param, tuple) else (request.param,)))
    try:
        yield ros_graph
    finally:
        ros_graph.close()
