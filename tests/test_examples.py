"""Every example runs to its end and leaves no regions behind."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import zlib
from contextlib import suppress
from pathlib import Path

import pytest

from .conftest import REPOSITORY
from .support import import_or_skip, rclcpp, ros1, ros2

OUTPUT = {
    "moving_pose": "400 poses received",
    "softplc_echo": "received by the PLC",
    "opcua_gateway": "name = ['shoulder', 'elbow']",
    "bridge_ros1": "the belt ran at 1.2, 0.6, 0.15, 0 m/s",
    "bridge_ros2": "the robot sends nothing: the feeder runs at 0.0 m/s",
    "machine_tending": "machine works on part 4: 3 parts taken",
    "robot_task": "3 tasks done, 1 refused",
    "robot_action": "3 tasks done, 1 refused, 1 cancelled",
    "dds_chatter": "a late subscriber receives the last count: 5",
    "zenoh_drive": "5 setpoints: the drive reached half of each",
    "press_service": "3 pressed",
    "open_plc": "generated for OpenPLC and Beremiz: openplc/shm_msgs.stlib",
    "ros1_cpp": "the belt ran at 1.2, 0.6, 0.15, 0 m/s",
    "cpp_loop": "3000 cycles, 0 not sent",
    "alarms": "the bridge is back: {'door': 'cleared, not acknowledged'}",
    "axes": "2 safe stops: standstill",
    "ros2_cpp": "the belt ran at 1.2, 0.6, 0.15, 0 m/s",
    "ros2_control": "the PLC killed: `read` is an error",
    "two_machines": "bridge of b killed: xStale after",
}
SEPARATE = {"softplc_echo", "two_machines"}
"""Examples with their own tests: softplc_echo is `make demo`, which test_readme.py runs."""
PACKAGES = {
    "alarms": ("cyclonedds",),
    "opcua_gateway": ("asyncua", "cyclonedds"),
    "machine_tending": ("cyclonedds",),
    "robot_action": ("cyclonedds",),
    "robot_task": ("cyclonedds",),
    "dds_chatter": ("cyclonedds",),
    "zenoh_drive": ("zenoh-ros2-sdk",),
}


def test_all_examples_are_listed() -> None:
    assert {path.parent.name for path in (REPOSITORY / "examples").glob("*/demo.py")} == set(OUTPUT)


@pytest.mark.parametrize("name", PACKAGES)
def test_examples_name_a_missing_package_at_once(name: str) -> None:
    """Print the command that installs it, which the example's page also shows."""
    page = (REPOSITORY / "examples" / name / "README.md").read_text()
    assert f".venv/bin/pip install {' '.join(PACKAGES[name])}\n" in page
    modules = [module.replace("-", "_") for module in PACKAGES[name]]
    without = f"import runpy, sys; sys.modules |= dict.fromkeys({modules!r}, None)"
    code = f"{without}; runpy.run_path('examples/{name}/demo.py', run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.endswith(f"pip install {' '.join(PACKAGES[name])}\n")


@pytest.mark.slow
def test_demos_without_blark_end_without_a_traceback() -> None:
    """Name the missing package instead. Only `make demo` installs blark."""
    without = "import runpy, sys; sys.modules['blark'] = None; runpy.run_path(sys.argv[1], run_name='__main__')"
    demos = [path.parent / "demo.py" for path in (REPOSITORY / "examples").glob("*/*.st")]
    for demo in sorted({demo for demo in demos if "start_plc" in demo.read_text()}):
        command = [sys.executable, "-c", without, str(demo)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        assert (done.returncode, done.stdout) == (1, ""), demo
        assert "Traceback" not in done.stderr
        hint = (
            "pip install blark\n" if ".venv/ros1" not in done.stderr and "no ROS 1" not in done.stderr else "makes it\n"
        )
        assert done.stderr.endswith((hint, "Debian's\n", "/setup.bash\n", "[ros2]'\n", "g++ is not installed\n")), (
            done.stderr
        )


BUILT = {"ros2_cpp": "rclcpp", "ros2_control": "hardware_interface"}
SLOW = {"ros1_cpp", *BUILT}  # compiling with roscpp and rclcpp takes long


def run_and_kill_the_rest(command: list[str | Path], environment: dict[str, str]) -> tuple[int, str]:
    """Run a command and kill the processes that it leaves. Otherwise the next run would find their regions in use."""
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    ) as process:
        try:
            output, _ = process.communicate(timeout=240)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    return process.returncode, output


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(example, marks=[pytest.mark.slow] if example in SLOW else [])
        for example in sorted(set(OUTPUT) - SEPARATE)
    ],
)
@pytest.mark.family("[moving_pose]")
def test_example_succeeds(example: str) -> None:
    if example != "moving_pose" and not shutil.which("g++"):
        pytest.skip("no g++: apt-get install g++")
    for module in PACKAGES.get(example, ()):
        import_or_skip(module.replace("-", "_"), reason=f"no {module} for this Python")
    if example == "bridge_ros2":
        ros2.prefix("jazzy")  # or skips
    if example in ("bridge_ros1", "ros1_cpp"):
        ros1.python()  # or skips
    if example == "ros1_cpp" and not (shutil.which("cmake") and Path("/usr/include/ros/ros.h").exists()):
        pytest.skip("no cmake, or no roscpp: `make test-all` as root installs Debian's")
    # Each example has its own DDS domain, so that no ROS 2 on this machine sees its topics.
    domain = {"ROS_DOMAIN_ID": str(1 + (os.getpid() + zlib.crc32(example.encode())) % 100)}
    environment = {**os.environ, **domain, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    if example in BUILT:
        environment |= rclcpp.environment(BUILT[example])  # or skips
    command = [sys.executable, REPOSITORY / "examples" / example / "demo.py"]
    status, output = run_and_kill_the_rest(command, environment)
    assert status == 0, output
    assert OUTPUT[example] in output
    assert left_behind(example) == []


@pytest.mark.sample("[dds-100]")
@pytest.mark.parametrize(("backend", "rate"), [("dds", 100), ("ros2", 500)])
def test_two_machines_count_lost_messages(backend: str, rate: int) -> None:
    """Send so fast with ros2 that more messages are lost during a cut than DDS keeps."""
    python = ros2.prefix("jazzy") / "bin" / "python" if backend == "ros2" else sys.executable
    if backend == "dds":
        import_or_skip("cyclonedds")
    command = [sys.executable, REPOSITORY / "examples" / "two_machines" / "demo.py"]
    words = ["--backend", backend, "--rate", str(rate), "--python", str(python)]
    result = subprocess.run([*command, *words], capture_output=True, text=True, check=False, timeout=240)
    if result.returncode == 77:
        pytest.skip(result.stdout.strip())
    assert result.returncode == 0, result.stdout + result.stderr
    assert OUTPUT["two_machines"] in result.stdout
    (missing,) = re.findall(r"after the cut\n.*; (\d+) lost,", result.stdout)
    assert (int(missing) > 500) == (backend == "ros2")
    calls = re.findall(r"every twentieth frame lost\n.*; (\d+) calls.*\n.*; (\d+) calls", result.stdout)
    assert backend == "ros2" or min(map(int, calls[0])) > 60  # of 170; 15 to 36 with Fast DDS's own heartbeat


def left_behind(example: str) -> list[Path]:
    """Return the files of the example's own topics, services and actions. Other examples may run at the same time."""
    texts = [path.read_text() for path in (REPOSITORY / "examples" / example).glob("*.*") if path.suffix != ".md"]
    topics = {
        name for text in texts for name in re.findall(r'(?i)^(?:topic|service|action) = "/(.+)"$', text, re.MULTILINE)
    }
    assert topics
    names = [name.replace("/", ".") for name in topics]
    return [path for name in names for path in Path("/dev/shm").glob(f"*{name}*")]
