"""Turns our messages and rosbags' typesdicts into the same plain tuples."""

from __future__ import annotations

from shmgen.model import Array, Clock, FieldType, Message, Ref, Scalar, Sequence, String

FILLER = "structure_needs_at_least_one_member"


def ours(message: Message) -> tuple[list, list]:
    """(name, type, value) of the constants, (name, type) of the fields."""
    constants = [(constant.name, plain(constant.type), constant.value) for constant in message.constants]
    return constants, [(field.name, plain(field.type)) for field in message.fields]


def plain(type: FieldType) -> tuple:
    match type:
        case Array(element, length):
            return "array", plain(element), length
        case Sequence(element, capacity):
            return "sequence", plain(element), capacity or 0
        case Clock():
            return ("name", f"builtin_interfaces/msg/{type.name.capitalize()}")
        case Ref(name):
            return "name", str(name)
        case String(capacity, wide):
            return "base", "wstring" if wide else "string", capacity or 0
        case Scalar():
            return "base", type.value, 0


def rosbags(definition: tuple[list, list], dialect: str) -> tuple[list, list]:
    """The same of a typesdict entry; `byte` and `char` as the dialect has them."""
    constants = [(name, base(type, 0, dialect), value) for name, type, value in definition[0]]
    return constants, [(name, node(type, dialect)) for name, type in definition[1] if name != FILLER]


def node(type: tuple, dialect: str) -> tuple:
    kind, content = type[0].name, type[1]
    if kind == "BASE":
        return base(*content, dialect)
    if kind == "NAME":
        return "name", content
    return kind.lower(), node(content[0], dialect), content[1]


def base(name: str, capacity: int, dialect: str) -> tuple:
    names = {"byte": "int8" if dialect == "ros1" else "uint8", "char": "uint8"}
    return "base", names.get(name, name), capacity
