"""Connects a PLC to a ROS 2 graph on rmw_zenoh, on a machine without ROS: `shmgen bridge --backend zenoh`."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402 the module is in examples/


def main() -> int:
    """Run the demo and return the exit status of the robot."""
    with cell(HERE, "blark", "zenoh-ros2-sdk") as here:
        here.generate()
        here.start_plc("PRG_Drive")
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            router = f'["tcp/127.0.0.1:{probe.getsockname()[1]}"]'
        here.environment["ZENOH_CONFIG_OVERRIDE"] = f'mode="router";listen/endpoints={router}'
        here.start_bridge("zenoh")
        here.environment["ZENOH_CONFIG_OVERRIDE"] = f"connect/endpoints={router}"
        return here.run("robot.py")


if __name__ == "__main__":
    sys.exit(main())
