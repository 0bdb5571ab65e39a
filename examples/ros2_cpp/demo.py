"""Builds a generated ROS 2 node in C++ that connects a PLC to a robot in rclpy. Needs a sourced ROS 2."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from rclcpp import build, needs  # noqa: E402 both modules are in examples/
from stage import cell  # noqa: E402


def main() -> int:
    """Run the demo and return the exit status of the robot."""
    needs("rclcpp")
    with cell(HERE, "blark") as here:
        here.generate()
        install = build(here, here.folder / "ros2_cpp" / "belt_bridge")
        here.start_plc("PRG_Belt")
        here.start_program("node", "sh", "-c", f"exec {install}/lib/belt_bridge/bridge 2>&1", ready="running")
        return subprocess.run(["python3", HERE / "robot.py"], env=here.environment, timeout=120, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
