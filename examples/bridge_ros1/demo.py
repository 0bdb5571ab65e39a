"""Connects a PLC to a ROS 1 graph: a master, `shmgen bridge`, a Structured Text program, and `rostopic`.

Needs Debian's ROS 1, which `make test-all` sets up. The demo starts its own master, so no other graph is disturbed.
"""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from graph import FORGET, PYTHON, Ros  # noqa: E402 both modules are in examples/
from stage import cell  # noqa: E402


def main() -> int:
    """Run the demo. Return 0 if the belt slowed down for the robot, and stopped when the robot stopped publishing."""
    if not PYTHON.exists():
        sys.exit(f"{PYTHON} is missing: `make test-all` as root installs Debian's ROS 1 and creates it")
    with cell(HERE, "blark") as here, ExitStack() as processes:
        here.generate()
        here.start_plc("PRG_Belt")
        ros = Ros(processes, "/shmgen_demo/robot", "/shmgen_demo/speed")
        ros.start("rosmaster", "rosmaster_main", "--core", "-p", str(ros.port))
        bridge = ros.start("shmgen.__main__", "main", "bridge", "-c", str(HERE / "shmgen.toml"), label="shmgen bridge")
        for line in bridge.stdout or ():
            print(f"   {line.rstrip()}", flush=True)
            if line.startswith("running"):
                break
        speeds = [ros.speed_with_robot_at(x) for x in (3.0, 1.0, 0.25)]
        time.sleep(FORGET)
        print("\n   the robot stops sending", flush=True)
        speeds.append(ros.speed())
    print(f"\n   the belt ran at {', '.join(f'{speed:g}' for speed in speeds)} m/s", flush=True)
    return 0 if speeds == [1.2, 0.6, 0.15, 0.0] else 1


if __name__ == "__main__":
    sys.exit(main())
