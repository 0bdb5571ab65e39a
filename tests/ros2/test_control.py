"""Test the package of `-t ros2_control`, loaded by hardware_interface's ResourceManager."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lxml import etree

from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import publisher, subscriber
from shmgen.live.session import Session

from ..conftest import REPOSITORY
from ..support import rclcpp
from ..support.build import put

pytestmark = pytest.mark.slow

MESSAGES = {
    "msgs/cell_msgs/msg/Command.msg": "uint8 enable\nuint8 reset\nbool stop\nfloat64[] position\n",
    "msgs/cell_msgs/msg/State.msg": "uint8 state\nuint16[6] status\nfloat64[6] position\nPart[2] parts\nint64 big\n",
    "msgs/cell_msgs/msg/Part.msg": "float32[] weights\n",
}
CONFIG = """path = ["msgs"]
ros_package = "cell_control"
[bounds]
"cell_msgs/Command" = 6
"cell_msgs/Part" = 3
[[topics]]
topic = "{space}/command"
type = "cell_msgs/Command"
[[topics]]
topic = "{space}/state"
type = "cell_msgs/State"
direction = "from_plc"
"""
LOOP = f"""cmake_minimum_required(VERSION 3.16)
project(loop CXX)
set(CMAKE_CXX_STANDARD 17)
find_package(hardware_interface REQUIRED)
add_executable(loop {REPOSITORY}/examples/ros2_control/loop.cpp)
add_executable(reactivate {Path(__file__).with_name("reactivate.cpp")})
foreach(program loop reactivate)
  target_link_libraries(${{program}} hardware_interface::hardware_interface)
  install(TARGETS ${{program}} DESTINATION bin)
endforeach()
"""
PLC = """
import sys
from types import SimpleNamespace
from tests.ros2.test_control import regions
command, state = regions(*sys.argv[1:])
with command as command, state as state:
    print("ready", flush=True)
    while True:
        sample = command.wait(0.02)
        if sample is None:
            state.heartbeat()
        else:
            position = list(sample.position)
            part = SimpleNamespace(weights=position[:2])
            status = [int(sample.enable)] * 6
            state.publish(SimpleNamespace(state=1, status=status, position=position, parts=[part, part], big=0))
"""


def regions(folder: str, space: str) -> tuple[Any, Any]:
    """Return the PLC's subscriber of commands and its publisher of states."""
    os.chdir(folder)
    kinds = Session(load(Path("shmgen.toml"), "shmgen.toml", Report())).classes(
        ["cell_msgs/Command", "cell_msgs/State"]
    )
    command = subscriber(kinds["cell_msgs/msg/Command"], f"{space}/command", 1)
    return command, publisher(kinds["cell_msgs/msg/State"], f"{space}/state", 1)


class Cell:
    """The generated package and the controller programs, built and installed by CMake."""

    def __init__(self, folder: Path) -> None:
        self.ros = rclcpp.environment("hardware_interface")
        self.space = f"/t{os.urandom(6).hex()}"
        self.folder = folder
        put(MESSAGES, folder)
        source = rclcpp.generated(folder, CONFIG.format(space=self.space), "ros2_control")
        self.install = rclcpp.built(source / "ros2_control" / "cell_control", folder / "package", self.ros)
        put({"loop/CMakeLists.txt": LOOP}, folder)
        self.programs = rclcpp.built(folder / "loop", folder / "of_loop", self.ros) / "bin"
        snippet = self.install / "share" / "cell_control" / "urdf" / "plc.ros2_control.xacro"
        (self.control,) = etree.fromstring(snippet.read_bytes()).iter("ros2_control")
        self.processes: list[subprocess.Popen[str]] = []

    def urdf(self, *changes: tuple[str, str]) -> Path:
        """Write a robot of six joints that includes the generated snippet with the given replacements."""
        robot = '<robot name="cell"><link name="l0"/>'
        for joint in range(1, 7):
            limit = '<limit lower="-1e9" upper="1e9" velocity="1" effort="1"/>'
            ends = f'<parent link="l{joint - 1}"/><child link="l{joint}"/>'
            robot += f'<link name="l{joint}"/><joint name="joint{joint}" type="revolute">{ends}{limit}</joint>'
        control = etree.tostring(self.control, encoding="unicode")
        for pattern, replacement in changes:
            control, count = re.subn(pattern, replacement, control, flags=re.DOTALL)
            assert count == 1, pattern
        file = self.folder / "robot.urdf"
        file.write_text(f"{robot}{control}</robot>")
        return file

    def start(self, command: list[Any]) -> subprocess.Popen[str]:
        settings = self.ros | {
            "AMENT_PREFIX_PATH": f"{self.install}:{self.ros['AMENT_PREFIX_PATH']}",
            "LD_LIBRARY_PATH": f"{self.install}/lib:{self.ros['LD_LIBRARY_PATH']}",
            "ROS_LOG_DIR": str(self.folder / "log"),
            "PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY}",
        }
        process = subprocess.Popen(
            [str(word) for word in command],
            env={**os.environ, **settings},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.processes.append(process)
        return process

    def plc(self) -> subprocess.Popen[str]:
        """Start a PLC that sends the received values back."""
        process = self.start([sys.executable, "-c", PLC, self.folder, self.space])
        read_until(process, "ready")
        return process

    def kill(self) -> None:
        for process in self.processes:
            process.kill()
            process.communicate()
        self.processes.clear()

    def clean_up(self) -> None:
        self.kill()
        for file in Path("/dev/shm").glob(f"*{self.space[1:]}.*"):
            file.unlink()

    def commands(self) -> Any:
        """Return a subscriber of the controller's commands."""
        kinds = Session(load(self.folder / "shmgen.toml", "shmgen.toml", Report())).classes(["cell_msgs/Command"])
        return subscriber(kinds["cell_msgs/msg/Command"], f"{self.space}/command", 1)

    def controller(self, cycles: int, *changes: tuple[str, str], enable: float = 1) -> subprocess.Popen[str]:
        return self.start([self.programs / "loop", self.urdf(*changes), cycles, enable])


def read_until(process: subprocess.Popen[str], word: str) -> list[str]:
    """Return all lines up to the first line with that word."""
    assert process.stdout
    lines = []
    for line in process.stdout:
        lines.append(line)
        if word in line:
            return lines
    raise AssertionError("".join(lines))


def read_result(process: subprocess.Popen[str]) -> dict[str, Any]:
    result: dict[str, Any] = json.loads(read_until(process, '{"')[-1])
    return result


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    created_cell = Cell(tmp_path_factory.mktemp("cell_control"))
    yield created_cell
    created_cell.clean_up()


@pytest.fixture(autouse=True)
def remove_regions(cell: Cell) -> Iterator[None]:
    """Remove the regions after each test, so that the next test reads no samples of this test."""
    yield
    cell.clean_up()


SAFE = r'(<command_interface name="enable">)(.*?)(<param name="field">)', r'\1\2<param name="safe">0</param>\3'


def test_values_pass_to_the_plc_and_back(cell: Cell) -> None:
    cell.plc()
    result = read_result(cell.controller(3000))
    assert (result["good_cycles"], result["failed_call"], result["wrong_positions"]) == (3000, "", 0), result
    assert result["new_positions"] > 2000, result


def test_killed_plc_is_an_error_and_sends_the_safe_command(cell: Cell) -> None:
    plc = cell.plc()
    controller = cell.controller(60_000, SAFE)
    read_until(controller, "running")
    time.sleep(0.5)
    plc.kill()
    started_at = time.monotonic()
    result = read_result(controller)
    assert time.monotonic() - started_at < 5
    assert (result["failed_call"], result["wrong_positions"]) == ("read", 0), result
    with cell.commands() as reader:
        last = reader.read()
    assert last is not None
    expected = (0, float(result["good_cycles"]))
    assert (last.enable, next(iter(last.position))) == expected, "enable is safe, the positions stay"


def test_plc_detects_a_killed_controller(cell: Cell) -> None:
    cell.plc()
    with cell.commands() as reader:
        for _ in range(3):
            controller = cell.controller(60_000)
            read_until(controller, "running")
            deadline = time.monotonic() + 20
            while reader.wait(0.5) is None or reader.is_stale(0.1):  # the sample may be from the previous controller
                assert time.monotonic() < deadline
            controller.kill()
            deadline = time.monotonic() + 2
            while not reader.is_stale(0.1):
                assert time.monotonic() < deadline


def test_command_out_of_range_is_an_error(cell: Cell) -> None:
    cell.plc()
    result = read_result(cell.controller(1000, enable=256))
    assert (result["failed_call"], result["good_cycles"]) == ("write", 0)


@pytest.mark.parametrize("reason", ["error", "deactivation"])
def test_activation_sends_no_old_commands(cell: Cell, reason: str) -> None:
    """Send only heartbeats until each command without a safe value is set again."""
    plc = cell.plc()
    hardware = cell.start([cell.programs / "reactivate", cell.urdf(SAFE)])
    read_until(hardware, "running")
    with cell.commands() as reader:
        request(hardware, "set 9 1")
        assert newest_enable(reader) == 1
        if reason == "error":
            plc.kill()
            read_until(hardware, "failed")
            cell.plc()
        else:
            request(hardware, "deactivate")
        assert newest_enable(reader) == 0, "the safe command"
        request(hardware, "activate")
        assert reader.wait(0.5) is None
        assert not reader.is_stale(0.1)
        request(hardware, "set 8 2")  # all but `enable`, which has a safe value
        assert newest_enable(reader) == 0
        request(hardware, "set 9 1")
        assert newest_enable(reader) == 1


def request(hardware: subprocess.Popen[str], line: str) -> None:
    assert hardware.stdin
    hardware.stdin.write(f"{line}\n")
    hardware.stdin.flush()
    read_until(hardware, "done")


def newest_enable(reader: Any) -> int:
    """Return the newest value of `enable` after the samples on their way have arrived."""
    first = reader.wait(5)
    assert first is not None
    time.sleep(0.1)
    return int((reader.read() or first).enable)


MISTAKES = {
    "index": (
        r"position\[5\](?=</param>\s*</command)",
        "position[6]",
        "joint6/position: position[6]: the array has 6 elements",
    ),
    "name": (r">status\[5\]<", ">stutus[5]<", "`stutus[5]` is not a number of the message, which has state, status[],"),
    "stale": (r'<param name="stale">0.1<', '<param name="stale">soon<', "stale must be a number, not `soon`"),
    "state": (r">stop</param>", ">position[0].x</param>", "`position[0].x` is not a number of the message"),
    "int64": (r">state</param>", ">big</param>", "`big` is not a number of the message"),
    "missing": (r'<param name="field">enable</param>', "", 'plc/enable: add <param name="field"> with the path'),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_in_the_urdf_is_refused_with_a_reason(cell: Cell, mistake: str) -> None:
    pattern, replacement, reason = MISTAKES[mistake]
    process = cell.controller(10, (pattern, replacement))
    assert reason in "".join(read_until(process, "refused"))


def test_element_beyond_a_sequence_has_no_value(cell: Cell) -> None:
    """Return parts[1].weights[1], but not parts[1].weights[2], which does not exist."""
    cell.plc()
    for index in (1, 2):
        field = (r">position\[1\](?=</param>\s*</state)", f">parts[1].weights[{index}]")
        result = read_result(cell.controller(500, field))
        assert result["failed_call"] == ""
        assert (result["wrong_positions"] > 0) == (index == 2), (index, result)
