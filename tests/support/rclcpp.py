"""Find a ROS 2 with rclcpp: the prefixes in SHMGEN_RCLCPP, a sourced ROS, or .venv/rclcpp, the first of these.

No package index has rclcpp. If SHMGEN_RCLCPP_SOURCES names a folder with the sources, `make test-all` builds
.venv/rclcpp. If no ROS has rclcpp, the tests that need rclcpp are skipped.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from . import REPOSITORY
from .build import put
from .command import run
from .ros1 import Bridge
from .ros2 import Graph

BUILT = REPOSITORY / ".venv" / "rclcpp"
"""The prefix into which tests/rigs/rclcpp.py builds packages."""
WHEELS = BUILT / "wheels"
"""The prefix with the wheels of ROS 2 that these packages require."""
JOINED = ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "LD_LIBRARY_PATH", "PATH")


def environment(package: str = "rclcpp") -> dict[str, str]:
    """Return the environment variables for programs with rclcpp. Skip the test if the package is missing."""
    named = os.environ.get("SHMGEN_RCLCPP") or os.environ.get("AMENT_PREFIX_PATH", "")
    prefixes = [Path(prefix) for prefix in named.split(":") if prefix] or [BUILT, WHEELS]
    if not any((prefix / "share" / package).is_dir() for prefix in prefixes):
        pytest.skip(f"no {package}: source a ROS 2 that has it, or see SHMGEN_RCLCPP in CONTRIBUTING.md")
    for tool in ("cmake", "g++"):
        if shutil.which(tool) is None:
            pytest.skip(f"no {tool}: apt-get install {tool}")
    return search_paths(prefixes)


def search_paths(prefixes: list[Path]) -> dict[str, str]:
    """Return the environment variables with which programs and CMake find the packages in `prefixes`."""
    return {name: ":".join([*map(str, _folders(name, prefixes)), *_known(name)]) for name in JOINED}


def _folders(name: str, prefixes: list[Path]) -> Iterator[Path]:
    for prefix in prefixes:
        match name:
            case "PATH":
                yield prefix / "bin"
            case "LD_LIBRARY_PATH":
                yield prefix / "lib"
                yield from prefix.glob("lib/python*/site-packages/*.libs")  # where it is made of wheels
            case _:
                yield prefix


def _known(name: str) -> list[str]:
    return [os.environ[name]] if name in ("PATH", "LD_LIBRARY_PATH") and os.environ.get(name) else []


def generated(folder: Path, config: str, *targets: str) -> Path:
    """Run `shmgen generate` in `folder` and return the output folder."""
    put({"shmgen.toml": config}, folder)
    result = run(["generate", "-q", *(word for target in targets for word in ("-t", target))], folder)
    assert result.code == 0, result.stderr
    return folder / "generated"


def built(source: Path, folder: Path, ros: Mapping[str, str], kind: str = "Release") -> Path:
    """Build and install a package with CMake and return the install folder."""
    bare = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    install = folder / "install"
    settings = (
        f"-DCMAKE_INSTALL_PREFIX={install}",
        f"-DCMAKE_BUILD_TYPE={kind}",
        "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Werror",
    )
    for command in (
        ["-S", source, "-B", folder / "build", *settings],
        ["--build", folder / "build", "--target", "install"],
    ):
        done = subprocess.run(
            ["cmake", *command], env={**bare, **ros}, capture_output=True, text=True, check=False
        )  # fmt: skip
        assert done.returncode == 0, (done.stdout + done.stderr)[-6000:]
    return install


class Node:
    """Generate the node with `-t ros2_cpp` for topics below `space`, and build and install it."""

    def __init__(self, folder: Path, space: str, config: str, kind: str = "Release") -> None:
        self.config, self.space = config, space
        self.ros = environment()
        source = generated(folder, config, "ros2_cpp") / "ros2_cpp" / "cell_bridge"
        self.install = built(source, folder, self.ros, kind)

    def start(self, graph: Graph, *arguments: str) -> Bridge:
        """Start the node and wait until it is ready."""
        (graph.folder / "shmgen.toml").write_text(self.config)
        paths = {
            "AMENT_PREFIX_PATH": f"{self.install}:{self.ros['AMENT_PREFIX_PATH']}",
            "LD_LIBRARY_PATH": f"{self.install}/lib:{self.ros['LD_LIBRARY_PATH']}",
        }  # as its local_setup does
        program = self.install / "lib" / "cell_bridge" / "bridge"
        node = Bridge(graph.start([program, *arguments], self.ros | paths, stderr=subprocess.STDOUT))
        node.wait_for_line("running")
        return node


class CppGraph(Graph):
    """A ROS graph whose bridge is the generated node in C++."""

    plain = ()

    def bridge(self, config: str = "", *arguments: str, ready: bool = True) -> Bridge:
        folder = Path(tempfile.mkdtemp(dir=self.folder))
        return Node(folder, "", 'ros_package = "cell_bridge"\n' + config).start(self)
