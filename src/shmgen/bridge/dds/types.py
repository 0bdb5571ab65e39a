"""Names and types for DDS: the topic names of ROS 2, and the structures by which Cyclone knows a type.

The codec in cdr.py converts the bytes of a message. Sources of the names: the ROS 2 design article *Topic and Service
name mapping to DDS*, and rosidl_generator_dds_idl.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, cast

from cyclonedds.idl import make_idl_struct, types

from shmgen.bridge.codec.type_identity import type_name
from shmgen.core.model import (
    Array,
    Clock,
    Element,
    Field,
    Message,
    Ref,
    Scalar,
    Sequence,
    String,
    TypeName,
    assert_never,
    element_of,
    ros_type,
)
from shmgen.core.type_hash import FILLER, TIMES

CALL = {"client_guid_": types.uint64, "sequence_number_": types.int64}
"""Fields that rmw_cyclonedds puts before a request and its reply to identify the call (`cdds_request_header`)."""
_LARGEST_BOUND = 65535
"""Maximum bound of a sequence in Cyclone's Python. A larger bound is omitted, which does not change the bytes."""
_TIME = {"sec_": types.int32, "nanosec_": types.uint32}


def topic_name(topic: str) -> str:
    """Return the DDS topic of a ROS topic: `rt/robot/pose` for `/robot/pose`."""
    return f"rt/{topic.strip('/')}"


def request_name(service: str) -> str:
    """Return the DDS topic of a service's requests: `rq/robot/stopRequest` for `/robot/stop`."""
    return f"rq/{service.strip('/')}Request"


def reply_name(service: str) -> str:
    """Return the DDS topic of a service's replies: `rr/robot/stopReply` for `/robot/stop`."""
    return f"rr/{service.strip('/')}Reply"


@functools.cache  # kept for ever: Cyclone still reads the type of a deleted topic
def structure(messages: tuple[Message, ...], *, of_call: bool = False) -> type[Any]:
    """Return Cyclone's structure for the last message of `messages`. The other messages are its dependencies.

    If `of_call` is True, the structure begins with the fields that identify a call (CALL). An object of the structure
    holds the sample's bytes as `cdr`, including the encapsulation header. Raises ValueError if a field is a `wstring`.
    """
    _refuse_wide(messages)
    structs = {name: _create_struct(name, _TIME) for name in TIMES.values()}
    for message in messages:
        first = CALL if of_call and message is messages[-1] else {}
        fields = {f"{field.name}_": _type_of(field, structs) for field in message.fields}
        structs[message.name] = _create_struct(message.name, {**first, **fields} or {f"{FILLER}_": types.byte})
    kind = structs[messages[-1].name]
    kind.serialize = _serialize
    kind.deserialize = classmethod(_deserialize)
    return kind


def _refuse_wide(messages: tuple[Message, ...]) -> None:
    for message in messages:
        for field in message.fields:
            if isinstance(type_ := element_of(field.type), String) and type_.wide:
                where, what = f"{message.name.short}.{field.name}", ros_type(field.type)
                raise ValueError(f"{where} is a {what}, which Cyclone's Python binding does not support; use string")


def sample(kind: type[Any], cdr: bytes) -> Any:
    """Wrap `cdr`, the bytes of a message, in an object that a writer of the structure `kind` accepts."""
    wrapped: Any = object.__new__(kind)
    wrapped.cdr = cdr
    return wrapped


def _serialize(self: Any, *_: object, **__: object) -> bytes:
    return cast(bytes, self.cdr)


def _deserialize(kind: type[Any], /, data: bytes, *_: object, **__: object) -> Any:
    return sample(kind, data)


def _create_struct(name: TypeName, fields: Mapping[str, Any]) -> type[Any]:
    return cast(type[Any], make_idl_struct(name.name, type_name(name), dict(fields)))


def _type_of(field: Field, structs: Mapping[TypeName, type[Any]]) -> Any:
    match field.type:
        case Array(element, length):
            return types.array[_element(element, structs), length]
        case Sequence(element, capacity) if capacity and capacity <= _LARGEST_BOUND:
            return types.sequence[_element(element, structs), capacity]
        case Sequence(element, _):
            return types.sequence[_element(element, structs)]
        case Scalar() | Clock() | String() | Ref() as type_:
            return _element(type_, structs)
        case _:
            assert_never(field.type)


def _element(type_: Element, structs: Mapping[TypeName, type[Any]]) -> Any:
    match type_:
        case Scalar.BOOL:
            return bool
        case Scalar.INT8 | Scalar.UINT8:  # octets, as in rosidl_generator_dds_idl
            return types.byte
        case Scalar():
            return getattr(types, type_.value)
        case Clock():
            return structs[TIMES[type_]]
        case String(None, _):
            return str
        case String(capacity, _):
            return types.bounded_str[capacity]
        case Ref(name):
            return structs[name]
        case _:
            assert_never(type_)
