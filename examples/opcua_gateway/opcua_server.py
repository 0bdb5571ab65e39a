"""Offers the newest sample of the topic /gateway/state as one OPC UA variable with the structure of the ROS message.

It replaces the OPC UA server of a PLC's runtime. The OPC UA types are generated from the ROS definitions. Their objects
have the attributes of the ROS messages, so a subscriber can read into them.

    python opcua_server.py shmgen.toml opc.tcp://127.0.0.1:4840
"""

from __future__ import annotations

import asyncio
import logging
import sys
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.structures104 import new_struct, new_struct_field
from shm_msgs.gateway_msgs.msg import RobotStateSubscriber

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.core.model import Array, Clock, Element, FieldType, Message, Ref, Scalar, Sequence, String
from shmgen.generator import pipeline

NAMESPACE = "urn:shmgen:examples:opcua_gateway"
TOPIC, TYPE = "/gateway/state", "gateway_msgs/RobotState"
NUMBERS = {
    Scalar.BOOL: "Boolean",
    Scalar.INT8: "SByte",
    Scalar.UINT8: "Byte",
    Scalar.INT16: "Int16",
    Scalar.UINT16: "UInt16",
    Scalar.INT32: "Int32",
    Scalar.UINT32: "UInt32",
    Scalar.INT64: "Int64",
    Scalar.UINT64: "UInt64",
    Scalar.FLOAT32: "Float",
    Scalar.FLOAT64: "Double",
}
"""The OPC UA type of each ROS number type (OPC 10000-6, table 1)."""


async def serve(configuration: Path, endpoint: str) -> None:
    """Run the server until the process is stopped."""
    schema = pipeline.read(config.load(configuration, configuration.name, Report()), [TYPE])
    server = Server()
    await server.init()
    server.set_endpoint(endpoint)
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    index = await server.register_namespace(NAMESPACE)
    types = await structures(server, index, schema.messages)
    classes = await server.load_data_type_definitions()
    state = classes[opcua_name(schema.messages[-1])]()
    empty = ua.Variant(state, ua.VariantType.ExtensionObject)
    place = ua.NodeId("state", index)
    variable = await server.nodes.objects.add_variable(place, "state", empty, datatype=types[TYPE].nodeid)
    async with server:
        print(f"serving {endpoint}", flush=True)
        with RobotStateSubscriber(TOPIC) as subscriber:
            while True:
                if subscriber.read_into(state):
                    await variable.write_value(ua.Variant(state, ua.VariantType.ExtensionObject))
                await asyncio.sleep(0.01)


async def structures(server: Server, index: int, messages: tuple[Message, ...]) -> dict[str, Any]:
    """Create an OPC UA structure for each message and for ROS's time. Return them by ROS name."""
    numbers = [new_struct_field(name, getattr(ua.VariantType, NUMBERS[kind])) for name, kind in TIME.items()]
    created = {"time": (await new_struct(server, index, "builtin_interfaces_Time", numbers))[0]}
    for message in messages:
        fields = [new_struct_field(field.name, *opcua_type(field.type, created)) for field in message.fields]
        created[message.name.short] = (await new_struct(server, index, opcua_name(message), fields))[0]
    return created


TIME = {"sec": Scalar.INT32, "nanosec": Scalar.UINT32}


def opcua_type(type_: FieldType, created: dict[str, Any]) -> tuple[Any, bool]:
    """Return the OPC UA data type of a field, and True if the field is an array."""
    if isinstance(type_, (Array, Sequence)):
        return opcua_element(type_.element, created), True
    return opcua_element(type_, created), False


def opcua_element(element: Element, created: dict[str, Any]) -> Any:
    match element:
        case Scalar():
            return getattr(ua.VariantType, NUMBERS[element])
        case String():
            return ua.VariantType.String
        case Clock():
            return created["time"]
        case Ref(name):
            return created[name.short]


def opcua_name(message: Message) -> str:
    return message.name.short.replace("/", "_")


if __name__ == "__main__":
    logging.getLogger("asyncua").setLevel(logging.ERROR)  # asyncua warns about missing certificates
    asyncio.run(serve(Path(sys.argv[1]), sys.argv[2]))
