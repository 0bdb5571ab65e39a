"""What DDS is told of a topic's type: ROS 2's names, and structures for Cyclone.

The structures say what the bytes are; the bytes themselves pass through unread, since `cdr` makes them.
Source of the names: the ROS 2 design article *Topic and Service name mapping to DDS*, rosidl_generator_dds_idl.
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
"""What rmw_cyclonedds puts before a request and its reply, to tell whose they are (its `cdds_request_header`)."""
_LARGEST_BOUND = 65535
"""What Cyclone's Python takes for a sequence; a larger one is declared without, and has no other bytes for it."""
_TIME = {"sec_": types.int32, "nanosec_": types.uint32}


def topic_name(topic: str) -> str:
    """`/robot/pose` is `rt/robot/pose`."""
    return f"rt/{topic.strip('/')}"


def request_name(service: str) -> str:
    """`/robot/stop` is asked on `rq/robot/stopRequest`."""
    return f"rq/{service.strip('/')}Request"


def reply_name(service: str) -> str:
    """`/robot/stop` answers on `rr/robot/stopReply`."""
    return f"rr/{service.strip('/')}Reply"


@functools.cache  # as long as the process lasts: Cyclone goes on to look at the type of a topic that was deleted
def structure(messages: tuple[Message, ...], *, of_call: bool = False) -> type[Any]:
    """Of the last of `messages`, which hold all it refers to; `of_call`, the fields of CALL come first.

    Its objects hold the sample as `cdr`, encapsulation included. Raises ValueError for a `wstring`.
    """
    _refuse_wide(messages)
    made = {name: _made(name, _TIME) for name in TIMES.values()}
    for message in messages:
        first = CALL if of_call and message is messages[-1] else {}
        fields = {f"{field.name}_": _typed(field, made) for field in message.fields}
        made[message.name] = _made(message.name, {**first, **fields} or {f"{FILLER}_": types.byte})
    kind = made[messages[-1].name]
    kind.serialize = _serialize
    kind.deserialize = classmethod(_deserialize)
    return kind


def _refuse_wide(messages: tuple[Message, ...]) -> None:
    for message in messages:
        for field in message.fields:
            if isinstance(type_ := element_of(field.type), String) and type_.wide:
                where, what = f"{message.name.short}.{field.name}", ros_type(field.type)
                raise ValueError(f"{where}: no {what} through DDS: Cyclone's Python does not know it; use string")


def sample(kind: type[Any], cdr: bytes) -> Any:
    """An object that a writer of `kind` takes."""
    made: Any = object.__new__(kind)
    made.cdr = cdr
    return made


def _serialize(self: Any, *_: object, **__: object) -> bytes:
    return cast(bytes, self.cdr)


def _deserialize(kind: type[Any], /, data: bytes, *_: object, **__: object) -> Any:
    return sample(kind, data)


def _made(name: TypeName, fields: Mapping[str, Any]) -> type[Any]:
    return cast(type[Any], make_idl_struct(name.name, type_name(name), dict(fields)))


def _typed(field: Field, made: Mapping[TypeName, type[Any]]) -> Any:
    match field.type:
        case Array(element, length):
            return types.array[_element(element, made), length]
        case Sequence(element, capacity) if capacity and capacity <= _LARGEST_BOUND:
            return types.sequence[_element(element, made), capacity]
        case Sequence(element, _):
            return types.sequence[_element(element, made)]
        case Scalar() | Clock() | String() | Ref() as type_:
            return _element(type_, made)
        case _:
            assert_never(field.type)


def _element(type_: Element, made: Mapping[TypeName, type[Any]]) -> Any:
    match type_:
        case Scalar.BOOL:
            return bool
        case Scalar.INT8 | Scalar.UINT8:  # octets all, as rosidl_generator_dds_idl has them
            return types.byte
        case Scalar():
            return getattr(types, type_.value)
        case Clock():
            return made[TIMES[type_]]
        case String(None, _):
            return str
        case String(capacity, _):
            return types.bounded_str[capacity]
        case Ref(name):
            return made[name]
        case _:
            assert_never(type_)
