"""C++ messages convert to ROS messages and back, compiled with the real headers of ROS 1 and ROS 2."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Span
from shmgen.generator import pipeline

from ..support import ros2
from ..support.build import put

HERE = Path(__file__).parent
PACKAGES = ["sensor_msgs", "visualization_msgs", "diagnostic_msgs", "std_srvs"]
TYPES = ["sensor_msgs/JointState", "visualization_msgs/Marker", "diagnostic_msgs/DiagnosticStatus", "std_srvs/SetBool"]

# The interface of REP 2007, because no package index has rclcpp.
TYPE_ADAPTER = """#pragma once
#include <type_traits>
namespace rclcpp {
template <typename CustomType, typename ROSMessageType = void, class Enable = void> struct TypeAdapter {
    using is_specialized = std::false_type;
    using custom_type = CustomType;
    using ros_message_type = CustomType;
};
}
"""


def find_ros1_headers() -> list[Path]:
    if not all(Path("/usr/include", package).is_dir() for package in PACKAGES):
        debian = [f"lib{package.replace('_', '-')}-dev" for package in PACKAGES]
        pytest.skip(f"no headers of ROS 1: apt-get install {' '.join(debian)}")
    return []


def find_ros2_headers() -> list[Path]:
    return sorted(folder for folder in (ros2.prefix("jazzy") / "include").iterdir() if folder.is_dir())


@pytest.mark.slow
@pytest.mark.parametrize("ros", [1, 2])
def test_cpp_messages_convert_to_ros_and_back(tmp_path: Path, topic: str, ros: int) -> None:
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed")
    headers = find_ros1_headers() if ros == 1 else find_ros2_headers()
    bounds = Bounds({}, {package: Bound(8, Span("shmgen.toml")) for package in PACKAGES})
    source = "noetic" if ros == 1 else "jazzy"
    config = Config(tmp_path, source=source, bounds=bounds, targets=("cpp", f"cpp_ros{ros}"))
    put(pipeline.generate(config, TYPES), tmp_path / "made")
    put({"stub/rclcpp/type_adapter.hpp": TYPE_ADAPTER}, tmp_path)
    roots = [tmp_path / "made" / root for root in ("cpp", f"cpp_ros{ros}")]
    command = ["g++", "-std=c++17", "-O1", "-Wall", "-Wextra", "-Wconversion", "-Werror", f"-DROS={ros}"]
    includes = [f"-I{folder}" for folder in (*roots, tmp_path / "stub")] + [f"-isystem{folder}" for folder in headers]
    program, libraries = tmp_path / "ros", ["-lrostime"] if ros == 1 else ["-pthread", "-lrt"]
    run = subprocess.run(
        [*command, *includes, HERE / "ros.cpp", "-o", program, *libraries], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr[:4000]
    run = subprocess.run([program, topic], capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stdout) == (0, "")
