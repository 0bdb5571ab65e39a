"""A zenoh router for each test that requests one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from ..support import import_or_skip
from ..support.zenoh import Graph

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")  # zenoh-ros2-sdk imports GitPython, which would require git
import_or_skip("zenoh", reason="no eclipse-zenoh: `pip install eclipse-zenoh`")
import_or_skip("xxhash")


@pytest.fixture
def graph(tmp_path: Path, space: str) -> Iterator[Graph]:
    """A graph. It ends before the regions of `space` are removed, because a running bridge would recreate them."""
    zenoh_graph = Graph(tmp_path)
    try:
        yield zenoh_graph
    finally:
        zenoh_graph.close()
