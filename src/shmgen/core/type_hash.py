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
    element_of,
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
_TIME_FIELDS: dict[str, FieldType] = {"sec": Scalar.INT32, "nanosec": Scalar.UINT32}


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
    described: dict[TypeName, tuple[str, list[TypeName]]] = {}
    result = {}
    for name in names:
        closure: set[TypeName] = set()
        waiting = [name]
        while waiting:
            part = waiting.pop()
            if part not in closure:
                closure.add(part)
                if part not in described:
                    described[part] = _describe(part, known)
                waiting += described[part][1]
        others = ", ".join(described[other][0] for other in sorted(closure - {name}, key=str))
        whole = f'{{"type_description": {described[name][0]}, "referenced_type_descriptions": [{others}]}}'
        result[name] = f"RIHS01_{hashlib.sha256(whole.encode()).hexdigest()}"
    return result


def _describe(name: TypeName, known: Mapping[TypeName, Message]) -> tuple[str, list[TypeName]]:
    """Return the description of a message as JSON, and the messages that its fields contain."""
    if name in TIMES.values():
        fields = create_message(name, _TIME_FIELDS).fields
    else:
        fields = known[name].fields or create_message(name, {FILLER: Scalar.UINT8}).fields
    text = json.dumps({"type_name": str(name), "fields": [_describe_field(field) for field in fields]})
    elements = (element_of(field.sent or field.type) for field in fields)
    return text, [nested for element in elements if (nested := _message_name(element))]


def _describe_field(field: Field) -> dict[str, Any]:
    """Describe a field for the hash. A capacity, in elements or in characters, of 0 means no bound."""
    match field.sent or field.type:
        case Array(element, length):
            container, capacity = _ARRAY, length
        case Sequence(element, None):
            container, capacity = _SEQUENCE, 0
        case Sequence(element, bound):
            container, capacity = _BOUNDED_SEQUENCE, bound or 0
        case Scalar() | Clock() | String() | Ref() as element:
            container, capacity = 0, 0
        case type_:
            assert_never(type_)
    match element:
        case Scalar():
            number, characters = _WORDS.get(field.word, _SCALARS[element]), 0
        case String(bound, wide):
            number, characters = (_WIDE if wide else _STRING) + (_BOUNDED if bound else 0), bound or 0
        case Clock() | Ref():
            number, characters = _NESTED, 0
        case _:
            assert_never(element)
    numbers = {
        "type_id": container + number,
        "capacity": capacity,
        "string_capacity": characters,
        "nested_type_name": str(_message_name(element) or ""),
    }
    return {"name": field.name, "type": numbers}


def _message_name(element: Element) -> TypeName | None:
    match element:
        case Ref(name):
            return name
        case Clock():
            return TIMES[element]
        case _:
            return None
