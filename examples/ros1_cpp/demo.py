"""Builds a ROS 1 node in C++ that connects a PLC, and reads its topics with `rostopic`.

Needs Debian's roscpp, ROS 1 for Python (`make test-all`), and cmake. The demo starts its own master, so no other graph
is disturbed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
sys.path.insert(0, str(HERE.parent))

from graph import FORGET, PYTHON, Ros  # noqa: E402 both modules are in examples/
from stage import Cell, cell  # noqa: E402


def main() -> int:
    """Run the demo. Return 0 if the belt slowed down for the robot, and stopped when the robot stopped publishing."""
    if not PYTHON.exists() or not Path("/usr/include/ros/ros.h").exists() or not shutil.which("cmake"):
        sys.exit("ROS 1 for C++ is missing: `make test-all` as root installs Debian's")
    with cell(HERE, "blark") as here, ExitStack() as processes:
        here.generate()
        node = build(here)
        here.start_plc("PRG_Belt")
        ros = Ros(processes, "/shmgen_node/robot", "/shmgen_node/speed")
        ros.start("rosmaster", "rosmaster_main", "--core", "-p", str(ros.port))
        print("\n$ cell_node", flush=True)
        environment = {**ros.environment, "ROSCONSOLE_STDOUT_LINE_BUFFERED": "1"}
        process = subprocess.Popen(
            [node], env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        processes.callback(process.wait)
        processes.callback(process.kill)
        assert process.stdout
        print(f"   {process.stdout.readline().strip()}", flush=True)
        speeds = [ros.speed_with_robot_at(x) for x in (3.0, 1.0, 0.25)]
        time.sleep(FORGET)
        print("\n   the robot stops sending", flush=True)
        speeds.append(ros.speed())
    print(f"\n   the belt ran at {', '.join(f'{speed:g}' for speed in speeds)} m/s", flush=True)
    return 0 if speeds == [1.2, 0.6, 0.15, 0.0] else 1


def build(here: Cell) -> Path:
    """Build the node with CMake and return the path of its program."""
    folder = here.folder / "node"
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    package = f"-Dshmgen_DIR={REPOSITORY / 'src' / 'shmgen' / 'cmake'}"
    print("\n$ cmake -S . -B node && cmake --build node", flush=True)
    for command in (["cmake", "-S", HERE, "-B", folder, package], ["cmake", "--build", folder]):
        done = subprocess.run(command, env={**os.environ, "PATH": path}, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(done.stdout + done.stderr)
    return folder / "cell_node"


if __name__ == "__main__":
    sys.exit(main())
