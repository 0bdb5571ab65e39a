"""Generates code for two topics, runs the PLC program in a 1 ms cycle, and lets a robot approach the conveyor."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402


def main() -> int:
    """Run the demo and return the exit status of the robot."""
    with cell(HERE, "blark") as here:
        here.generate()
        for path in sorted(here.folder.rglob("*onveyor*")):
            if path.is_file():
                print(f"   {path.relative_to(here.folder)}")
        here.shmgen("show", "geometry_msgs/Pose")
        here.start_plc("PRG_Conveyor")
        return here.run("robot.py", "/cell/pose", "/cell/conveyor")


if __name__ == "__main__":
    sys.exit(main())
