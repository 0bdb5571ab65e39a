"""Compute the hash by which ROS 2 identifies a definition (REP 2016, version 1: `RIHS01_…`).

The hash covers the names and types of all fields, including nested messages. The types are those of ROS: bounds from
shmgen.toml do not change the hash. Constants, defaults and comments are not part of the hash. ROS 1 has no such hash.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from shmgen.core.diagnostics import Span
from shmgen.core.model import (
    Array,
    Clock,
    Element,
    Field,
    FieldType,
    Message,
    Ref,
    Scalar,
    Sequence,
    String,
    TypeName,
    assert_never,
    ros_type,
)

FILLER = "structure_needs_at_least_one_member"
"""The uint8 field that ROS 2 adds to a message without fields, because IDL has no empty structure."""
TIMES = {
    Clock.TIME: TypeName("builtin_interfaces", "msg", "Time"),
    Clock.DURATION: TypeName("builtin_interfaces", "msg", "Duration"),
}

# The numbers are those of type_description_interfaces/msg/FieldType.
_NESTED = 1
_SCALARS = {
    Scalar.INT8: 2,
    Scalar.UINT8: 3,
    Scalar.INT16: 4,
    Scalar.UINT16: 5,
    Scalar.INT32: 6,
    Scalar.UINT32: 7,
    Scalar.INT64: 8,
    Scalar.UINT64: 9,
    Scalar.FLOAT32: 10,
    Scalar.FLOAT64: 11,
    Scalar.BOOL: 15,
}
_WORDS = {"char": 13, "wchar": 14, "byte": 16}
_STRING, _WIDE, _BOUNDED = 17, 18, 4
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144
_EVENT_INFO: dict[str, FieldType] = {
    "event_type": Scalar.UINT8,
    "stamp": Clock.TIME,
    "client_gid": Array(Scalar.UINT8, 16),
    "sequence_number": Scalar.INT64,
}

_Description = dict[str, Any]


def type_hash(messages: Iterable[Message]) -> str:
    """Return the hash of the last of `messages`. The others include all messages that the last message contains."""
    known = {message.name: message for message in messages}
    *_, last = known
    return hash_of(last, known)


def service_hash(request: tuple[Message, ...], response: tuple[Message, ...]) -> str:
    """Return the hash of the service with this request and this response.

    The last message of each tuple is the request or the response itself, after the messages that its fields contain.
    """
    halves = Ref(request[-1].name), Ref(response[-1].name)
    whole = halves[0].name._replace(name=halves[0].name.name.removesuffix("_Request"))
    info = create_message(TypeName("service_msgs", "msg", "ServiceEventInfo"), _EVENT_INFO)
    request_event, response_event = (Sequence(half, 1) for half in halves)
    event = create_message(
        whole.part("_Event"), {"info": Ref(info.name), "request": request_event, "response": response_event}
    )
    parts = {"request_message": halves[0], "response_message": halves[1], "event_message": Ref(event.name)}
    return type_hash((*request, *response, info, event, create_message(whole, parts)))


def create_message(name: TypeName, fields: Mapping[str, FieldType]) -> Message:
    """Create the definition of a message that ROS 2 derives from a service or an action, and that has no file."""
    place = Span(str(name))
    members = tuple(Field(field, type_, ros_type(type_), place) for field, type_ in fields.items())
    text = "".join(f"{field.written} {field.name}\n" for field in members)
    return Message(name, members, (), place, name.package, text)


def hash_of(name: TypeName, known: Mapping[TypeName, Message]) -> str:
    """Return the hash of the message `name`. `known` has the definitions of this message and of all its parts."""
    return hashes([name], known)[name]


def hashes(names: Iterable[TypeName], known: Mapping[TypeName, Message]) -> dict[TypeName, str]:
    """Return the hash of each message in `names`. `known` has the definitions of all these messages and their parts."""
    described: dict[TypeName, str] = {}
    nested: dict[TypeName, set[TypeName]] = {}

    def text(name: TypeName) -> str:
        if name not in described:
            described[name] = json.dumps(_describe(name, known))
        return described[name]

    result = {}
    for name in names:
        others = ", ".join(text(other) for other in sorted(_with_nested(name, known, nested) - {name}, key=str))
        whole = f'{{"type_description": {text(name)}, "referenced_type_descriptions": [{others}]}}'
        result[name] = f"RIHS01_{hashlib.sha256(whole.encode()).hexdigest()}"
    return result


def _with_nested(
    name: TypeName, known: Mapping[TypeName, Message], nested: dict[TypeName, set[TypeName]]
) -> set[TypeName]:
    """Return the message `name` and all messages that it contains, at any depth. `nested` caches direct references."""
    result: set[TypeName] = set()
    waiting = [name]
    while waiting:
        name = waiting.pop()
        if name not in result:
            result.add(name)
            if name not in nested:
                nested[name] = {inner for field in _fields(name, known) if (inner := _message_name(_parts(field)[1]))}
            waiting += nested[name]
    return result


def _fields(name: TypeName, known: Mapping[TypeName, Message]) -> tuple[Field, ...]:
    return known[name].fields if name in known else ()


def _describe(name: TypeName, known: Mapping[TypeName, Message]) -> _Description:
    if name in TIMES.values():
        fields = [_field("sec", 6), _field("nanosec", 7)]
    else:
        fields = [_field(field.name, *_numbers(field)) for field in known[name].fields] or [_field(FILLER, 3)]
    return {"type_name": str(name), "fields": fields}


def _field(name: str, number: int, capacity: int = 0, characters: int = 0, nested: str = "") -> _Description:
    """Describe a field for the hash. `number` is the id of its type.

    `capacity` is the bound in elements, `characters` the bound in characters. 0 means no bound.
    """
    type_ = {"type_id": number, "capacity": capacity, "string_capacity": characters, "nested_type_name": nested}
    return {"name": name, "type": type_}


def _numbers(field: Field) -> tuple[int, int, int, str]:
    """Return the values that describe the type of a field in the hash, in the order of _field()'s parameters.

    The values are the id of the type, its bounds in elements and in characters (0: no bound), and the name of the
    message that the field contains, or `""`.
    """
    container, element, capacity = _parts(field)
    match element:
        case Scalar():
            number, characters = _WORDS.get(field.word, _SCALARS[element]), 0
        case String(bound, wide):
            number, characters = (_WIDE if wide else _STRING) + (_BOUNDED if bound else 0), bound or 0
        case Clock() | Ref():
            number, characters = _NESTED, 0
        case _:
            assert_never(element)
    nested = _message_name(element)
    return container + number, capacity, characters, str(nested) if nested else ""


def _parts(field: Field) -> tuple[int, Element, int]:
    """Split the type of a field: return a number for its kind, the element type, and the capacity in elements.

    The number, which is added to the id of the element type, represents an array, a bounded sequence or an unbounded
    sequence. It is 0 for any other type. The capacity is 0 if there is no bound.
    """
    match field.sent or field.type:
        case Array(element, length):
            return _ARRAY, element, length
        case Sequence(element, None):
            return _SEQUENCE, element, 0
        case Sequence(element, capacity):
            return _BOUNDED_SEQUENCE, element, capacity or 0
        case Scalar() | Clock() | String() | Ref() as element:
            return 0, element, 0
        case type_:
            assert_never(type_)


def _message_name(element: Element) -> TypeName | None:
    match element:
        case Ref(name):
            return name
        case Clock():
            return TIMES[element]
        case _:
            return None
