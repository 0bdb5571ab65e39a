"""A machine reports a finished part to a mobile manipulator: from the PLC through the bridge to DDS, and back."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402


def main() -> int:
    """Run the demo and return the exit status of the robot."""
    with cell(HERE, "blark", "cyclonedds") as here:
        here.generate()
        here.start_plc("PRG_Machine")
        here.start_bridge("dds")
        return here.run("robot.py")


if __name__ == "__main__":
    sys.exit(main())
