"""Test that PyPI's colcon builds the output of `-t ros2` and the recipe of docs/drift.md, and runs the bridge there."""

from __future__ import annotations

import re
import signal
import subprocess
from pathlib import Path

import pytest

from ..conftest import REPOSITORY
from ..support.build import put
from ..support.command import run
from ..support.ros1 import Bridge
from ..support.ros2 import Graph

RECIPE = (REPOSITORY / "docs" / "drift.md").read_text().partition("## CMake and colcon")[2]
_, CMAKE = re.findall(r"```cmake\n(.*?)```", RECIPE, re.DOTALL)
(MANIFEST,) = re.findall(r"```xml\n(.*?)```", RECIPE, re.DOTALL)
INTERFACES = """cmake_minimum_required(VERSION 3.16)
project(demo_msgs C)
find_package(ament_cmake REQUIRED)
install(FILES msg/Robot.msg DESTINATION share/demo_msgs/msg)
ament_export_dependencies(rcutils)
ament_package()
"""
"""A package with the exports of an interface package, but without rosidl's code, which takes most of a minute."""


@pytest.fixture
def workspace(tmp_path: Path, space: str) -> Path:
    topic = f'ros_package = "cell_bridge"\n[[topics]]\ntopic = "{space}/pose"\ntype = "geometry_msgs/Pose"\n'
    source = tmp_path / "src"
    put(
        {
            "shmgen.toml": topic,
            "src/demo_msgs/package.xml": MANIFEST.replace("demo_shm", "demo_msgs").replace(
                "<depend>demo_msgs</depend>", "<depend>rcutils</depend>"
            ),
            "src/demo_msgs/CMakeLists.txt": INTERFACES,
            "src/demo_msgs/msg/Robot.msg": "float64 speed\n",
            "src/demo_shm/package.xml": MANIFEST,
            "src/demo_shm/CMakeLists.txt": CMAKE,
            "src/demo_shm/shmgen.toml": 'messages = ["demo_msgs"]\n',
        },
        tmp_path,
    )
    result = run(["generate", "-q", "-t", "ros2", "-o", str(source)], tmp_path)
    assert result.code == 0, result.stderr
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("graph", ["jazzy"], indirect=True)
def test_workspace_is_built_and_runs_the_bridge(graph: Graph, workspace: Path) -> None:
    tools = graph.prefix / "bin"
    if not (tools / "colcon").exists() or not (graph.prefix / "share" / "ament_cmake").is_dir():
        pytest.skip("no colcon or no ament_cmake in .venv/ros2-jazzy: `make test-all` installs them")
    paths = {"PATH": f"{tools}:/usr/bin:/bin", "CMAKE_PREFIX_PATH": str(graph.prefix), "ROS_DISTRO": "jazzy"}
    build = graph.start([tools / "colcon", "build"], paths, stderr=subprocess.STDOUT)
    output = build.stdout.read()
    assert build.wait() == 0, output
    assert "CMake Warning" not in output
    installed = workspace / "install"
    for file in ("include/shm_msgs/demo_msgs/msg/robot.h", "share/demo_shm/shmgen/plcopen/shmgen.xml"):
        assert (installed / "demo_shm" / file).is_file()

    share = "install/cell_bridge/share/cell_bridge/config"
    command = f"install/cell_bridge/lib/cell_bridge/bridge -c {share}/shmgen.toml --backend ros2"
    command += f" --ros-args -r __node:=cell_bridge --params-file {share}/bridge.yaml"  # like the launch file
    shell = ["sh", "-c", f". install/local_setup.sh && exec {command}"]
    bridge = Bridge(graph.start(shell, paths, stderr=subprocess.STDOUT))
    bridge.wait_for_line("^running")
    bridge.stop(signal.SIGINT)
