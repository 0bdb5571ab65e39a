"""The hash by which ROS 2 knows a definition (REP 2016, version 1: `RIHS01_…`).

It is taken over what a message is in ROS, whatever shmgen.toml bounds it to: names and types of all fields, also of
those in the messages it holds. Constants, defaults and comments are not in it. ROS 1 has no such hash.
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
"""The uint8 that ROS 2 gives a message without fields, since IDL knows no empty structure."""
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

_Described = dict[str, Any]


def type_hash(messages: Iterable[Message]) -> str:
    """Of the last of `messages`, which hold all it refers to."""
    known = {message.name: message for message in messages}
    *_, last = known
    return hash_of(last, known)


def service_hash(request: tuple[Message, ...], response: tuple[Message, ...]) -> str:
    """Of the service whose halves are the last of each; they hold all that these refer to."""
    halves = Ref(request[-1].name), Ref(response[-1].name)
    whole = halves[0].name._replace(name=halves[0].name.name.removesuffix("_Request"))
    info = made_message(TypeName("service_msgs", "msg", "ServiceEventInfo"), _EVENT_INFO)
    request_event, response_event = (Sequence(half, 1) for half in halves)
    event = made_message(
        whole.part("_Event"), {"info": Ref(info.name), "request": request_event, "response": response_event}
    )
    parts = {"request_message": halves[0], "response_message": halves[1], "event_message": Ref(event.name)}
    return type_hash((*request, *response, info, event, made_message(whole, parts)))


def made_message(name: TypeName, fields: Mapping[str, FieldType]) -> Message:
    """One that ROS 2 itself makes of services and actions, of which nobody has written a file."""
    place = Span(str(name))
    made = tuple(Field(field, type_, ros_type(type_), place) for field, type_ in fields.items())
    text = "".join(f"{field.written} {field.name}\n" for field in made)
    return Message(name, made, (), place, name.package, text)


def hash_of(name: TypeName, known: Mapping[TypeName, Message]) -> str:
    """Of the message called `name`, which is in `known`, as is all it refers to."""
    return hashes([name], known)[name]


def hashes(names: Iterable[TypeName], known: Mapping[TypeName, Message]) -> dict[TypeName, str]:
    """The same of several, which describes what many of them hold once."""
    described: dict[TypeName, str] = {}
    held: dict[TypeName, set[TypeName]] = {}

    def text(name: TypeName) -> str:
        if name not in described:
            described[name] = json.dumps(_described(name, known))
        return described[name]

    found = {}
    for name in names:
        others = ", ".join(text(other) for other in sorted(_held(name, known, held) - {name}, key=str))
        whole = f'{{"type_description": {text(name)}, "referenced_type_descriptions": [{others}]}}'
        found[name] = f"RIHS01_{hashlib.sha256(whole.encode()).hexdigest()}"
    return found


def _held(name: TypeName, known: Mapping[TypeName, Message], held: dict[TypeName, set[TypeName]]) -> set[TypeName]:
    """The message and all in it, however deep; `held` remembers what each holds itself."""
    found: set[TypeName] = set()
    waiting = [name]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            if name not in held:
                held[name] = {inner for field in _fields(name, known) if (inner := _named(_parts(field)[1]))}
            waiting += held[name]
    return found


def _fields(name: TypeName, known: Mapping[TypeName, Message]) -> tuple[Field, ...]:
    return known[name].fields if name in known else ()


def _described(name: TypeName, known: Mapping[TypeName, Message]) -> _Described:
    if name in TIMES.values():
        fields = [_field("sec", 6), _field("nanosec", 7)]
    else:
        fields = [_field(field.name, *_numbers(field)) for field in known[name].fields] or [_field(FILLER, 3)]
    return {"type_name": str(name), "fields": fields}


def _field(name: str, number: int, capacity: int = 0, characters: int = 0, nested: str = "") -> _Described:
    """`capacity` is in elements, 0 if there is no bound."""
    type_ = {"type_id": number, "capacity": capacity, "string_capacity": characters, "nested_type_name": nested}
    return {"name": name, "type": type_}


def _numbers(field: Field) -> tuple[int, int, int, str]:
    """As _field() takes them."""
    around, element, capacity = _parts(field)
    match element:
        case Scalar():
            number, characters = _WORDS.get(field.word, _SCALARS[element]), 0
        case String(bound, wide):
            number, characters = (_WIDE if wide else _STRING) + (_BOUNDED if bound else 0), bound or 0
        case Clock() | Ref():
            number, characters = _NESTED, 0
        case _:
            assert_never(element)
    nested = _named(element)
    return around + number, capacity, characters, str(nested) if nested else ""


def _parts(field: Field) -> tuple[int, Element, int]:
    """What an array or sequence adds to the number, what it holds, and how many."""
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


def _named(element: Element) -> TypeName | None:
    match element:
        case Ref(name):
            return name
        case Clock():
            return TIMES[element]
        case _:
            return None
