"""Generates code for two topics, runs the PLC side of it in a 1 ms cycle, and lets a robot walk up to the conveyor."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402


def main() -> int:
    """Exit status of the robot."""
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
