"""Uses a PLC as the gateway between ROS and OPC UA: robot, DDS, bridge, region, PLC, region, OPC UA server, client."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from stage import cell  # noqa: E402


def main() -> int:
    """Run the demo and return the exit status of the OPC UA client."""
    endpoint = f"opc.tcp://127.0.0.1:{free_port()}"
    with cell(HERE, "asyncua", "blark", "cyclonedds") as here:
        here.generate()
        here.start_plc("PRG_Gateway")
        here.start_bridge("dds")
        here.start("robot", HERE / "robot.py", ready="on its way")
        here.start("OPC UA server", HERE / "opcua_server.py", HERE / "shmgen.toml", endpoint, ready="serving")
        print("\nWhat an OPC UA client reads", flush=True)
        return here.run("client.py", endpoint)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


if __name__ == "__main__":
    sys.exit(main())
