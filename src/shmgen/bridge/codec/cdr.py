"""Encodes and decodes messages in the ROS 2 wire format (XCDR1, little-endian), with codecs of rosbags."""

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
"""The message that replaces a `wstring`, because rosbags does not support it: a sequence of UTF-16 units."""


@dataclass(frozen=True, slots=True)
class Codec:
    """Encodes and decodes the messages of one type. `new()` creates an empty message.

    The encoded bytes begin with the 4 bytes of the CDR encapsulation header. `type_hash` is the hash of REP 2016,
    `RIHS01_…`. `decode` raises ValueError if the bytes are not a message of this type.
    """

    new: Callable[[], Any]
    encode: Callable[[Any], bytes]
    decode: Callable[[bytes | memoryview], Any]
    type_hash: str


@functools.cache  # rosbags compiles new classes in each call
def codec(messages: tuple[Message, ...], wide_unit: Literal[2, 4] = 4) -> Codec:
    """Return the codec for the type of the last of `messages`. The other messages are its dependencies.

    `wide_unit` is the size in bytes of a unit of a `wstring`: 4 in code for Fast DDS, 2 in rmw_cyclonedds.
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
    lists = (field.element for field in fields if isinstance(field, (Array, Sequence)))
    # If foreign, the messages contain values that _to_rosbags() must convert for rosbags.
    foreign = wide or any(isinstance(element, Ref) and _has_numbers(element, known) for element in lists)

    def encode(message: Any) -> bytes:
        if foreign:
            message = _to_rosbags(message, Ref(top), known, kinds)
        return bytes(store.serialize_cdr(message, str(top), little_endian=True))

    def decode(data: bytes | memoryview) -> Any:
        try:
            if wide:  # Fast DDS adds unused bytes after a wstring, which rosbags rejects
                definition = store.get_msgdef(str(top))
                read = definition.deserialize_cdr_le if data[1] else definition.deserialize_cdr_be
                return _decode_wstrings(read(bytes(data[4:]), 0, definition.cls, store)[0], Ref(top), known)
            return store.deserialize_cdr(data, str(top))
        except (SerdeError, struct.error, IndexError) as error:
            raise ValueError(str(error)) from error

    # Decode an empty message: this takes a third of the time of creating one. Arrays of a bytearray are writable.
    blank = encode(_empty(Ref(top), known, kinds))
    return Codec(lambda: decode(memoryview(bytearray(blank))), encode, decode, type_hash(messages))


def _definitions(messages: tuple[Message, ...], unit: str) -> dict[str, Any]:
    """Return the definitions of `messages` in the form that rosbags requires. `unit` is the type of a UTF-16 unit."""
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


def _has_numbers(type_: FieldType, known: Mapping[TypeName, Message]) -> bool:
    """Return True if the type contains lists of numbers, or a message without fields."""
    match type_:
        case Ref(name):
            fields = known[name].fields  # empty: rosbags requires a filler field, which other libraries lack
            return not fields or any(_has_numbers(field.type, known) for field in fields)
        case Array(element) | Sequence(element):
            return isinstance(element, Scalar) or _has_numbers(element, known)
        case _:
            return False


def _to_rosbags(value: Any, type_: FieldType, known: Mapping[TypeName, Message], kinds: Mapping[str, Any]) -> Any:
    """Convert a field's value to the form that rosbags can encode: objects of rosbags's classes, and ndarrays.

    `known` maps the name of a message type to its definition, and `kinds` to its class in rosbags.
    """
    match type_:
        case Ref(name):
            kind, fields = kinds[str(name)], known[name].fields
            if not fields:
                return kind(0)
            members = (name for name in kind.__dataclass_fields__ if name != "__msgtype__")
            return kind(
                *(
                    _to_rosbags(getattr(value, member), field.type, known, kinds)
                    for member, field in zip(members, fields, strict=True)
                )
            )
        case String(_, True):
            units = _numbers(value.encode("utf-16-le"), Scalar.UINT16)
            return kinds[_WIDE](units)
        case Array(Scalar() as scalar) | Sequence(Scalar() as scalar):
            return _numbers(value, scalar)
        case Array(Ref() | String(_, True) as element) | Sequence(Ref() | String(_, True) as element):
            return [_to_rosbags(item, element, known, kinds) for item in value]
        case _:
            return value


def _decode_wstrings(value: Any, type_: FieldType, known: Mapping[TypeName, Message]) -> Any:
    """Replace each object with UTF-16 units by a `str`. Raises ValueError if a surrogate pair is incomplete."""
    match type_:
        case Ref(name):
            members = [name for name in value.__dataclass_fields__ if name != "__msgtype__"]
            for member, field in zip(members, known[name].fields, strict=False):
                setattr(value, member, _decode_wstrings(getattr(value, member), field.type, known))
            return value
        case String(_, True):
            return value.units.astype("<u2").tobytes().decode("utf-16-le")
        case Array(Ref() | String(_, True) as element) | Sequence(Ref() | String(_, True) as element):
            return [_decode_wstrings(item, element, known) for item in value]
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
