"""A ROS 1 graph for each test that wants one, and regions that leave nothing behind."""

from __future__ import annotations

import uuid
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


@pytest.fixture
def space() -> Iterator[str]:
    """A namespace for topics that nobody else uses; their regions go afterwards."""
    name = f"t{uuid.uuid4().hex[:12]}"
    yield f"/{name}"
    for file in Path("/dev/shm").glob(f"*{name}.*"):
        file.unlink()
