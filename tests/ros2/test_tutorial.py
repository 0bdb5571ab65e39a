"""Test docs/tutorial-ros.md: its rclpy node sends a topic to its PLC program and receives a topic from it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time

import pytest

from ..conftest import REPOSITORY
from ..softplc import compile_st
from ..support.ros1 import LIMIT
from ..support.ros2 import Graph
from ..support.tutorial import project

PAGE = REPOSITORY / "docs" / "tutorial-ros.md"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++: apt-get install g++")
@pytest.mark.parametrize("graph", [("jazzy", "ros2")], indirect=True, ids="-".join)
def test_node_of_the_tutorial_receives_the_topic_of_the_plc(graph: Graph, space: str) -> None:
    settings, _, st = project(PAGE.name, graph.folder, space)
    compile_st(st, graph.folder / "plc")
    graph.bridge(settings.replace('topic = "', f'topic = "{space}'))
    (node,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (graph.folder / "example.py").write_text(re.sub(r'"(/\w+/\w+)"', rf'"{space}\1"', node))
    command = [sys.executable, "-m", "tests.softplc.task", graph.folder / "plc" / "plc.so", "PRG_Ros", "PRG_Belt"]
    with subprocess.Popen(command, cwd=REPOSITORY) as plc:
        try:
            peer = graph.start([graph.python, "example.py"])
            deadline, line = time.monotonic() + LIMIT, ""
            while line != "0.75":
                assert time.monotonic() < deadline, f"the node printed {line!r} last"
                line = peer.stdout.readline().strip()
        finally:
            plc.kill()
