"""A domain of ROS 2 for each test that wants one, with real rclpy in it."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from ..support.ros2 import Graph


@pytest.fixture(scope="session")
def domain(testrun_uid: str, worker_id: str) -> int:
    """One for each worker, out of those whose ports Linux gives to nobody else."""
    number = int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0
    return 1 + (zlib.crc32(testrun_uid.encode()) + number + 50) % 100


@pytest.fixture(params=["jazzy", "kilted"])
def graph(request: pytest.FixtureRequest, tmp_path: Path, domain: int, space: str) -> Iterator[Graph]:
    """Ends before the regions of `space` go: a bridge makes them anew."""
    made = Graph(tmp_path, domain, *(request.param if isinstance(request.param, tuple) else (request.param,)))
    try:
        yield made
    finally:
        made.close()
