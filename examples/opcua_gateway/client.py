"""A supervisor that uses only OPC UA, not ROS or shmgen: reads the robot's state until it is complete.

python client.py opc.tcp://127.0.0.1:4840
"""

from __future__ import annotations

import asyncio
import logging
import sys

from asyncua import Client, ua

NAMESPACE = "urn:shmgen:examples:opcua_gateway"


async def watch(endpoint: str, seconds: float = 60.0) -> int:
    """Read the robot's state from the server. Return 0 once ten poses and the joints have arrived."""
    async with Client(endpoint, timeout=30, watchdog_intervall=30) as client:  # seconds, for a busy machine
        index = await client.get_namespace_index(NAMESPACE)
        await client.load_data_type_definitions()
        for _ in range(int(seconds / 0.1)):
            state = await client.get_node(ua.NodeId("state", index)).read_value()
            if state.poses >= 10 and state.joints.name:
                show(state)
                return 0
            await asyncio.sleep(0.1)
    print(f"no value was received within {seconds} s", file=sys.stderr)
    return 1


def show(value: object, name: str = "state", indent: int = 0) -> None:
    """Print one field per line, indented like the message."""
    if hasattr(value, "__dataclass_fields__"):
        print(f"   {'  ' * indent}{name}: {type(value).__name__}")
        for field in value.__dataclass_fields__:
            show(getattr(value, field), field, indent + 1)
    else:
        print(f"   {'  ' * indent}{name} = {value}")


if __name__ == "__main__":
    logging.getLogger("asyncua").setLevel(logging.ERROR)  # asyncua warns about missing certificates
    sys.exit(asyncio.run(watch(sys.argv[1])))
