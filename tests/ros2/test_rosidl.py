"""Test packaging/rosidl_generator_shmgen: colcon builds unmodified interface packages with shmgen's code."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from shmgen.drift import lockfile

from ..conftest import REPOSITORY
from ..support import ros2
from ..support.build import put
from ..support.wheels import cmake_prefix

PLUGIN = "rosidl_generator_shmgen"
MANIFEST = """<package format="3">
  <name>{name}</name><version>0.1.0</version><description>of a test</description>
  <maintainer email="you@example.org">you</maintainer><license>none</license>
  <buildtool_depend>ament_cmake</buildtool_depend><buildtool_depend>rosidl_default_generators</buildtool_depend>
  {depends}{group}
  <export><build_type>ament_cmake</build_type></export>
</package>
"""
INTERFACES = """cmake_minimum_required(VERSION 3.20)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package({depends} REQUIRED)
rosidl_generate_interfaces(${{PROJECT_NAME}}
  {files}
  DEPENDENCIES {depends})
ament_package()
"""
CELL = {
    "msg/Robot.msg": "# A robot.\nstd_msgs/Header header\nfloat64[] joints  # rad\nstring name\n",
    "msg/Speed.idl": "module cell_msgs { module msg { struct Speed { double value; sequence<long, 4> of; }; }; };\n",
    "srv/Stop.srv": "bool now\n---\nbool ok\n",
    "action/Move.action": "float64 goal\n---\nbool ok\n---\nfloat64 left\n",
    "shmgen.toml": '[bounds]\n"cell_msgs/Robot.joints" = 6\n[strings]\ndefault = 40\n',
}
PLANT = {"msg/Few.msg": "cell_msgs/Robot first\n", "msg/Open.msg": "cell_msgs/Robot[] many\n"}
LINE = """cmake_minimum_required(VERSION 3.20)
project(line CXX)
find_package(ament_cmake REQUIRED)
find_package(plant_msgs REQUIRED)
add_executable(line line.cpp)
target_compile_features(line PRIVATE cxx_std_17)
target_compile_options(line PRIVATE -Wall -Wextra -Werror)
target_link_libraries(line PRIVATE ${plant_msgs_TARGETS})
install(TARGETS line DESTINATION lib/line)
ament_package()
"""
PROGRAM = """#include "shm_msgs_ros2/plant_msgs/msg/few.hpp"
#include "shm_msgs/cell_msgs/srv/stop_service.hpp"
int main(int, char **arguments)
{
    plant_msgs::msg::Few theirs;
    theirs.first.joints = {1.5, 2.5};
    theirs.first.name = "one";
    shm_msgs::plant_msgs::msg::Few ours;
    if (!shmgen::from_ros(theirs, ours) || shmgen::to_ros(ours) != theirs)
        return 1;
    theirs.first.joints.resize(7);
    if (shmgen::from_ros(theirs, ours)) // six fit
        return 2;
    shm_msgs::cell_msgs::msg::RobotPublisher robot(arguments[1]); // its header is the other package's
    return robot.publish({}) ? 0 : 3;
}
"""


def package(name: str, files: dict[str, str], depends: str) -> dict[str, str]:
    """Return the files of an ordinary interface package. Only its shmgen.toml refers to shmgen."""
    group = "<member_of_group>rosidl_interface_packages</member_of_group>"
    quoted = "\n  ".join(f'"{file}"' for file in files if "/" in file)
    package_files = {
        "package.xml": MANIFEST.format(name=name, depends=f"<depend>{depends}</depend>", group=group),
        "CMakeLists.txt": INTERFACES.format(name=name, files=quoted, depends=depends),
        **files,
    }
    return {f"src/{name}/{path}": text for path, text in package_files.items()}


def usable_prefix(wheels: Path, prefix: Path) -> Path:
    """Return a prefix of the wheels that CMake can use. Skip the test if a tool is missing."""
    if not all(
        (wheels / place).exists()
        for place in ("bin/colcon", "share/rosidl_default_generators", "share/ament_cmake_ros")
    ):
        pytest.skip("no colcon or no rosidl_default_generators in .venv/ros2-jazzy: `make test-all` installs them")
    return cmake_prefix(wheels, prefix)


def read_lock(share: Path) -> lockfile.Lock:
    return lockfile.read((share / "shmgen" / "layout.lock").read_text(), "")


@pytest.mark.exhaustive
@pytest.mark.timeout(900)
@pytest.mark.parametrize("graph", ["jazzy"], indirect=True)
def test_colcon_build_generates_code_for_every_interface_package(
    graph: ros2.Graph, tmp_path: Path, corpus: Path, topic: str
) -> None:
    prefix = usable_prefix(graph.prefix, tmp_path / "prefix")
    statistics = {f"msg/{file.name}": file.read_text() for file in (corpus / "jazzy/statistics_msgs/msg").iterdir()}
    workspace = tmp_path / "workspace"
    put(
        {
            **package("cell_msgs", CELL, "std_msgs"),
            **package("plant_msgs", PLANT, "cell_msgs"),
            **package("statistics_msgs", statistics, "builtin_interfaces"),
            "src/line/package.xml": MANIFEST.format(name="line", depends="<depend>plant_msgs</depend>", group=""),
            "src/line/CMakeLists.txt": LINE,
            "src/line/line.cpp": PROGRAM,
        },
        workspace,
    )
    settings = {
        "PATH": f"{prefix / 'bin'}:/usr/bin:/bin",
        "AMENT_PREFIX_PATH": str(prefix),
        "CMAKE_PREFIX_PATH": str(prefix),
        "LD_LIBRARY_PATH": str(prefix / "lib"),
        "shmgen_DIR": str(REPOSITORY / "src/shmgen/cmake"),
        "ROS_DISTRO": "jazzy",
    }

    def colcon(*words: Any, code: int = 0, shell: str = "") -> str:
        command = " ".join(["colcon build --event-handlers console_direct+", *map(str, words)])
        process = graph.start(["sh", "-c", f"cd {workspace} && {shell} {command}"], settings, stderr=subprocess.STDOUT)
        output: str = process.stdout.read()
        assert process.wait() == code, output[-6000:]
        return output

    colcon("--base-paths", REPOSITORY / "packaging" / PLUGIN)
    output = colcon(shell=". install/local_setup.sh &&")
    assert "1 message left out for lack of bounds, see `shmgen list`:\n  statistics_msgs/MetricsMessage\n" in output
    assert "  plant_msgs/Open\n" in output

    shares = {
        name: workspace / "install" / name / "share" / name for name in ("cell_msgs", "plant_msgs", "statistics_msgs")
    }
    cell, plant = read_lock(shares["cell_msgs"]), read_lock(shares["plant_msgs"])
    assert {
        "cell_msgs/msg/Robot",
        "cell_msgs/msg/Speed",
        "cell_msgs/srv/Stop_Request",
        "cell_msgs/action/Move_Goal",
    } <= set(cell.requested)
    assert cell.messages["cell_msgs/msg/Robot"].fields["joints"].count == 6
    assert plant.messages["cell_msgs/msg/Robot"] == cell.messages["cell_msgs/msg/Robot"]
    for name, share in shares.items():
        assert (share / "shmgen/plcopen/shmgen.xml").is_file()
        assert (share / "shmgen/st" / name).is_dir()
    assert "statistics_msgs/msg/StatisticDataPoint" in read_lock(shares["statistics_msgs"]).requested
    headers = {
        name: {
            file.relative_to(share.parents[1] / "include" / name)
            for file in share.parents[1].glob("include/*/shm_*/**/*.h*")
        }
        for name, share in shares.items()
    }
    assert Path("shm_msgs_ros2/cell_msgs/msg/robot.hpp") in headers["cell_msgs"]
    assert headers["plant_msgs"]
    assert not headers["plant_msgs"] & headers["cell_msgs"]  # linked, not generated again

    program = [
        "sh",
        "-c",
        f". {workspace}/install/local_setup.sh && exec {workspace}/install/line/lib/line/line {topic}",
    ]
    assert graph.start(program, settings).wait() == 0

    put({"src/plant_msgs/shmgen.toml": '[bounds]\n"cell_msgs/Robot.joints" = 7\n"plant_msgs" = 2\n'}, workspace)
    output = colcon("--packages-select plant_msgs", code=2, shell=". install/local_setup.sh &&")
    assert "error[SHM401]: layout of cell_msgs/Robot changed\n  joints   count 6 -> 7\n" in output
