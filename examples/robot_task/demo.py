"""An IEC program sets up and starts a robot's tasks, through the bridge and a ROS 2 service over DDS."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402


def main() -> int:
    """Run the demo and return the exit status of the supervisor."""
    with cell(HERE, "blark", "cyclonedds") as here:
        here.generate()
        here.start("robot", HERE / "robot.py", ready="waits for tasks")
        here.start_bridge("dds")
        here.start_plc("PRG_Recipe")
        return here.run("supervisor.py")


if __name__ == "__main__":
    sys.exit(main())
