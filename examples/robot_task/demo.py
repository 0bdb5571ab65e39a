"""A robot's tasks, parameterised and started from an IEC program, across region, bridge and a service of DDS."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402


def main() -> int:
    """Exit status of the supervisor."""
    with cell(HERE, "blark", "cyclonedds") as here:
        here.generate()
        here.start("robot", HERE / "robot.py", ready="waits for tasks")
        here.start_bridge("dds")
        here.start_plc("PRG_Recipe")
        return here.run("supervisor.py")


if __name__ == "__main__":
    sys.exit(main())
