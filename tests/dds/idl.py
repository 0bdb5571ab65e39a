"""Render message definitions as IDL with ROS 2's names, from which peers are compiled."""

from __future__ import annotations

from collections.abc import Iterable

from shmgen.core.model import Array, Clock, Element, Field, Message, Ref, Scalar, Sequence, String, TypeName

IDL_TYPES = {
    Scalar.BOOL: "boolean",
    Scalar.INT8: "octet",
    Scalar.UINT8: "octet",
    Scalar.INT16: "short",
    Scalar.UINT16: "unsigned short",
    Scalar.INT32: "long",
    Scalar.UINT32: "unsigned long",
    Scalar.INT64: "long long",
    Scalar.UINT64: "unsigned long long",
    Scalar.FLOAT32: "float",
    Scalar.FLOAT64: "double",
}
"""The IDL types that rosidl_generator_dds_idl writes."""
TIMES = {Clock.TIME: "Time_", Clock.DURATION: "Duration_"}


def idl(messages: Iterable[Message]) -> str:
    """Render all messages as one file, dependencies first."""
    parts = [
        _struct("builtin_interfaces", "msg", name, ["long sec_;", "unsigned long nanosec_;"]) for name in TIMES.values()
    ]
    for message in messages:
        members = [_member(field) for field in message.fields] or ["octet structure_needs_at_least_one_member_;"]
        parts.append(_struct(message.name.package, message.name.kind, f"{message.name.name}_", members))
    return "\n".join(parts)


def scoped(name: TypeName) -> str:
    """Return ROS 2's DDS name of the type."""
    return f"{name.package}::{name.kind}::dds_::{name.name}_"


def _struct(package: str, kind: str, name: str, members: list[str]) -> str:
    body = "\n".join(f"  {member}" for member in members)
    return f"module {package} {{ module {kind} {{ module dds_ {{\nstruct {name} {{\n{body}\n}};\n}}; }}; }};\n"


def _member(field: Field) -> str:
    match field.type:
        case Array(element, length):
            return f"{_element(element)} {field.name}_[{length}];"
        case Sequence(element, capacity):
            bound = f", {capacity}" if capacity else ""
            return f"sequence<{_element(element)}{bound}> {field.name}_;"
        case type_:
            return f"{_element(type_)} {field.name}_;"


def _element(type_: Element) -> str:
    match type_:
        case Scalar():
            return IDL_TYPES[type_]
        case Clock():
            return f"builtin_interfaces::msg::dds_::{TIMES[type_]}"
        case String(capacity, _):
            return f"string<{capacity}>" if capacity else "string"
        case Ref(name):
            return scoped(name)
