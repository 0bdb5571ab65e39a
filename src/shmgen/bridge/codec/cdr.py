"""Writes and reads messages as ROS 2 sends them (XCDR1 of OMG's DDS-XTypes, little-endian).

rosbags does it: it compiles a codec for each type, and its messages bear the names that ROS's have in Python.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from shmgen.core.model import (
    Array,
    Clock,
    Element,
    FieldType,
    Message,
    Ref,
    Scalar,
    Sequence,
    String,
    TypeName,
    assert_never,
    element_of,
)
from shmgen.core.type_hash import FILLER, TIMES, type_hash

_WIDE = "shmgen/msg/WString"
"""A `wstring`, which rosbags does not know: its UTF-16 units behind their number."""


@dataclass(frozen=True, slots=True)
class Codec:
    """`new()` makes an empty message; `encode` and `decode` have the four bytes of encapsulation in front.

    `decode` raises ValueError for bytes that are no such message. `type_hash` is that of REP 2016, `RIHS01_…`.
    """

    new: Callable[[], Any]
    encode: Callable[[Any], bytes]
    decode: Callable[[bytes | memoryview], Any]
    type_hash: str


@functools.cache  # rosbags compiles classes for each
def codec(messages: tuple[Message, ...], wide_unit: Literal[2, 4] = 4) -> Codec:
    """For the last of `messages`, which hold all it refers to.

    `wide_unit` is the bytes that an UTF-16 unit of a `wstring` has: 4 where rosidl's code for Fast DDS makes them, 2 in
    rmw_cyclonedds.
    """
    from rosbags.serde import SerdeError
    from rosbags.typesys.store import Typestore

    store = Typestore()
    unit = f"uint{8 * wide_unit}"
    store.register(_definitions(messages, unit))
    kinds: dict[str, Any] = {**store.types, _WIDE: lambda units: store.types[_WIDE](units.astype(unit))}
    top = messages[-1].name
    known = {message.name: message for message in messages}
    fields = [field.type for message in messages for field in message.fields]
    wide = any(isinstance(type_ := element_of(field), String) and type_.wide for field in fields)
    foreign = wide or any(_has_numbers_in_elements(field, known) for field in fields)

    def encode(message: Any) -> bytes:
        if foreign:
            message = _converted(message, Ref(top), known, kinds)
        return bytes(store.serialize_cdr(message, str(top), little_endian=True))

    def decode(data: bytes | memoryview) -> Any:
        try:
            if wide:  # Fast DDS leaves more room behind one than it needs, which rosbags takes for an error
                kept = store.get_msgdef(str(top))
                read = kept.deserialize_cdr_le if data[1] else kept.deserialize_cdr_be
                return _texts(read(bytes(data[4:]), 0, kept.cls, store)[0], Ref(top), known)
            message = store.deserialize_cdr(data, str(top))
        except (SerdeError, struct.error, IndexError) as error:
            raise ValueError(str(error)) from error
        return message

    # Decoding an empty message takes a third of the time of making one; of a bytearray its arrays can be written to.
    blank = encode(_empty(Ref(top), known, kinds))
    return Codec(lambda: decode(memoryview(bytearray(blank))), encode, decode, type_hash(messages))


def _definitions(messages: tuple[Message, ...], unit: str) -> dict[str, Any]:
    """As rosbags wants them."""
    from rosbags.interfaces import Nodetype

    def element(type_: Element) -> Any:
        match type_:
            case Scalar():
                return Nodetype.BASE, (type_.value, 0)
            case Clock():
                return Nodetype.NAME, str(TIMES[type_])
            case String(_, True):
                return Nodetype.NAME, _WIDE
            case String(capacity, _):
                return Nodetype.BASE, ("string", capacity or 0)
            case Ref(name):
                return Nodetype.NAME, str(name)
            case _:
                assert_never(type_)

    def described(type_: FieldType) -> Any:
        match type_:
            case Array(inner, length):
                return Nodetype.ARRAY, (element(inner), length)
            case Sequence(inner, capacity):
                return Nodetype.SEQUENCE, (element(inner), capacity or 0)
            case inner:
                return element(inner)

    filler = [(FILLER, (Nodetype.BASE, ("uint8", 0)))]
    seconds = [("sec", (Nodetype.BASE, ("int32", 0))), ("nanosec", (Nodetype.BASE, ("uint32", 0)))]
    units = [("units", (Nodetype.SEQUENCE, ((Nodetype.BASE, (unit, 0)), 0)))]
    return (
        {_WIDE: ([], units)}
        | {str(name): ([], list(seconds)) for name in TIMES.values()}
        | {
            str(message.name): ([], [(field.name, described(field.type)) for field in message.fields] or filler)
            for message in messages
        }
    )


def _has_numbers_in_elements(type_: FieldType, known: Mapping[TypeName, Message]) -> bool:
    """Whether it is a list of messages that are empty, or have arrays of numbers: rosbags takes ndarrays only."""
    if not isinstance(type_, (Array, Sequence)) or not isinstance(type_.element, Ref):
        return False
    return _has_numbers(type_.element, known)


def _has_numbers(type_: FieldType, known: Mapping[TypeName, Message]) -> bool:
    match type_:
        case Ref(name):
            fields = known[name].fields  # none: rosbags has a filler there, which nobody else has
            return not fields or any(_has_numbers(field.type, known) for field in fields)
        case Array(element) | Sequence(element):
            return isinstance(element, Scalar) or _has_numbers(element, known)
        case _:
            return False


def _converted(value: Any, type_: FieldType, known: Mapping[TypeName, Message], kinds: Mapping[str, Any]) -> Any:
    """An object with ROS's attributes, or a list of such, as rosbags's own class with ndarrays in it."""
    match type_:
        case Ref(name):
            kind, fields = kinds[str(name)], known[name].fields
            if not fields:
                return kind(0)
            members = (name for name in kind.__dataclass_fields__ if name != "__msgtype__")
            return kind(
                *(
                    _converted(getattr(value, member), field.type, known, kinds)
                    for member, field in zip(members, fields, strict=True)
                )
            )
        case String(_, True):
            units = _numbers(value.encode("utf-16-le"), Scalar.UINT16)
            return kinds[_WIDE](units)
        case Array(Scalar() as scalar) | Sequence(Scalar() as scalar):
            return _numbers(value, scalar)
        case Array(Ref() | String(_, True) as element) | Sequence(Ref() | String(_, True) as element):
            return [_converted(item, element, known, kinds) for item in value]
        case _:
            return value


def _texts(value: Any, type_: FieldType, known: Mapping[TypeName, Message]) -> Any:
    """The same with `str` for each `wstring`. Raises ValueError for half a character."""
    match type_:
        case Ref(name):
            members = [name for name in value.__dataclass_fields__ if name != "__msgtype__"]
            for member, field in zip(members, known[name].fields, strict=False):
                setattr(value, member, _texts(getattr(value, member), field.type, known))
            return value
        case String(_, True):
            return value.units.astype("<u2").tobytes().decode("utf-16-le")
        case Array(Ref() | String(_, True) as element) | Sequence(Ref() | String(_, True) as element):
            return [_texts(item, element, known) for item in value]
        case _:
            return value


def _numbers(value: Any, scalar: Scalar) -> Any:
    import numpy

    if isinstance(value, (bytes, bytearray)):
        return numpy.frombuffer(value, dtype=scalar.value)
    return numpy.asarray(value, dtype=scalar.value)


def _empty(type_: FieldType, known: Mapping[TypeName, Message], kinds: Mapping[str, Any]) -> Any:
    match type_:
        case Scalar.BOOL:
            return False
        case Scalar():
            return 0.0 if type_.is_float else 0
        case Clock():
            return kinds[str(TIMES[type_])](0, 0)
        case String():
            return ""
        case Ref(name):
            return kinds[str(name)](*[_empty(field.type, known, kinds) for field in known[name].fields] or [0])
        case Array(Scalar() as scalar, length):
            return _numbers([0] * length, scalar)
        case Array(element, length):
            return [_empty(element, known, kinds) for _ in range(length)]
        case Sequence(Scalar() as scalar):
            return _numbers([], scalar)
        case Sequence():
            return []
        case _:
            assert_never(type_)
