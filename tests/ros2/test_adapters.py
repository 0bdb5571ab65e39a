"""Test the TypeAdapters of `-t cpp_ros2` in rclcpp nodes, with and without intra-process communication."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ..conftest import REPOSITORY
from ..support import rclcpp
from ..support.build import put

HERE = Path(__file__).parent
CONFIG = """source = "jazzy"
messages = ["geometry_msgs/PoseStamped", "sensor_msgs/JointState"]
targets = ["cpp", "cpp_ros2"]
[bounds]
"sensor_msgs/JointState" = 8
"""
CMAKE = f"""cmake_minimum_required(VERSION 3.20)
project(adapters CXX)
set(CMAKE_CXX_STANDARD 17)
find_package(rclcpp REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(sensor_msgs REQUIRED)
set(shmgen_DIR {REPOSITORY}/src/shmgen/cmake)
set(SHMGEN_EXECUTABLE {Path(sys.executable).parent}/shmgen)
find_package(shmgen REQUIRED)
shmgen_generate(messages)
add_executable(adapters {HERE}/adapters.cpp)
target_link_libraries(adapters messages rclcpp::rclcpp ${{geometry_msgs_TARGETS}} ${{sensor_msgs_TARGETS}})
install(TARGETS adapters DESTINATION bin)
"""


@pytest.mark.slow
def test_adapters_convert_messages_and_survive_misfits(tmp_path: Path, topic: str, domain: int) -> None:
    ros = rclcpp.environment()
    put({"CMakeLists.txt": CMAKE, "shmgen.toml": CONFIG}, tmp_path)
    program = rclcpp.built(tmp_path, tmp_path, ros) / "bin" / "adapters"
    settings = {
        **ros,
        "TOPIC": topic,
        "ROS_LOG_DIR": str(tmp_path),
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    result = subprocess.run([program], env=settings, capture_output=True, text=True, timeout=300, check=False)
    assert (result.returncode, result.stdout) == (0, ""), result.stdout + result.stderr
