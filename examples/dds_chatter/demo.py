"""Connects a PLC to a ROS 2 graph on a machine without ROS: `shmgen bridge --backend dds`, a program, and a talker."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402 the module is in examples/


def main() -> int:
    """Run the demo and return the exit status of the talker."""
    with cell(HERE, "blark", "cyclonedds") as here:
        here.generate()
        here.start_plc("PRG_Listener")
        here.start_bridge("dds")
        return here.run("talker.py")


if __name__ == "__main__":
    sys.exit(main())
