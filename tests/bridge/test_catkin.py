"""catkin_make of Debian builds what `-t ros1` writes, and roslaunch starts the bridge out of the workspace."""

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
def test_a_workspace_is_built_and_launched(graph: Graph, space: str) -> None:
    topic = f'source = "noetic"\nros_package = "cell_bridge"\n[[topics]]\ntopic = "{space}/pose"\n'
    put({"shmgen.toml": topic + 'type = "geometry_msgs/Pose"\n'}, graph.folder)
    result = run(["generate", "-q", "-t", "ros1", "-o", "src"], graph.folder)
    assert result.code == 0, result.stderr
    python = f"-DPYTHON_EXECUTABLE={graph.python}"
    here = {"PWD": str(graph.folder)}  # which catkin_make takes for the folder it is in
    build = graph.start(["catkin_make", "-j1", "install", python], here, stderr=subprocess.STDOUT)
    said = build.stdout.read()
    assert build.wait() == 0, said
    assert "CMake Warning" not in said
    shell = ["sh", "-c", ". install/setup.sh && exec roslaunch cell_bridge bridge.launch"]
    paths = {"PATH": f"{graph.python.parent}:/usr/bin:/bin"}  # its Python runs what catkin installs, and has shmgen
    launched = Bridge(graph.start(shell, paths, stderr=subprocess.STDOUT))
    launched.wait_for_line("^running")
    launched.stop(signal.SIGINT)
