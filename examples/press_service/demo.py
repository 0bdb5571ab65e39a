"""Runs a press that serves calls and also makes calls, both through services in shared memory."""

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
        here.start_plc("PRG_Press")
        return here.run("robot.py", "/press/run", "/press/unload")


if __name__ == "__main__":
    sys.exit(main())
