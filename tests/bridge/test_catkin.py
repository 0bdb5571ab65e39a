"""Test that Debian's catkin_make builds the output of `-t ros1`, and that roslaunch starts the bridge from there."""

from __future__ import annotations

import shutil
import signal
import subprocess

import pytest

from ..support.build import put
from ..support.command import run
from ..support.ros1 import Bridge, Graph


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("catkin_make") is None, reason="no catkin_make: apt-get install catkin")
def test_catkin_workspace_is_built_and_launched(graph: Graph, space: str) -> None:
    topic = f'source = "noetic"\nros_package = "cell_bridge"\n[[topics]]\ntopic = "{space}/pose"\n'
    put({"shmgen.toml": topic + 'type = "geometry_msgs/Pose"\n'}, graph.folder)
    result = run(["generate", "-q", "-t", "ros1", "-o", "src"], graph.folder)
    assert result.code == 0, result.stderr
    python = f"-DPYTHON_EXECUTABLE={graph.python}"
    variables = {"PWD": str(graph.folder)}  # catkin_make uses PWD as the working folder
    build = graph.start(["catkin_make", "-j1", "install", python], variables, stderr=subprocess.STDOUT)
    output = build.stdout.read()
    assert build.wait() == 0, output
    assert "CMake Warning" not in output
    shell = ["sh", "-c", ". install/setup.sh && exec roslaunch cell_bridge bridge.launch"]
    paths = {"PATH": f"{graph.python.parent}:/usr/bin:/bin"}  # this Python runs the installed scripts and has shmgen
    bridge = Bridge(graph.start(shell, paths, stderr=subprocess.STDOUT))
    bridge.wait_for_line("^running")
    bridge.stop(signal.SIGINT)
