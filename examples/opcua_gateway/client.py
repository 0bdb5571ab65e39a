"""A supervisor that knows OPC UA and neither ROS nor the PLC: reads the robot's state until it holds what is wanted.

python client.py opc.tcp://127.0.0.1:4840
"""

from __future__ import annotations

import asyncio
import logging
import sys

from asyncua import Client, ua

NAMESPACE = "urn:shmgen:examples:opcua_gateway"


async def watch(endpoint: str, seconds: float = 60.0) -> int:
    """0 once ten poses and the joints have come through."""
    async with Client(endpoint, timeout=30, watchdog_intervall=30) as client:  # seconds: machines may be busy
        index = await client.get_namespace_index(NAMESPACE)
        await client.load_data_type_definitions()
        for _ in range(int(seconds / 0.1)):
            state = await client.get_node(ua.NodeId("state", index)).read_value()
            if state.poses >= 10 and state.joints.name:
                show(state)
                return 0
            await asyncio.sleep(0.1)
    print(f"nothing came in {seconds} s", file=sys.stderr)
    return 1


def show(value: object, name: str = "state", indent: int = 0) -> None:
    """One field a line, nested as the message is."""
    if hasattr(value, "__dataclass_fields__"):
        print(f"   {'  ' * indent}{name}: {type(value).__name__}")
        for field in value.__dataclass_fields__:
            show(getattr(value, field), field, indent + 1)
    else:
        print(f"   {'  ' * indent}{name} = {value}")


if __name__ == "__main__":
    logging.getLogger("asyncua").setLevel(logging.ERROR)  # it warns of the lack of certificates
    sys.exit(asyncio.run(watch(sys.argv[1])))
