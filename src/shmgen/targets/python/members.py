"""Turns the slots of a Layout into the members of a generated class: how each is stored, shown and annotated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from typing import NamedTuple

from shmgen.core.model import Clock, Element, Ref, Role, Scalar, Slot, String, TypeName, TypeOptions, assert_never
from shmgen.targets.python import codec
from shmgen.targets.python.names import PYTHON_STORED, python_member

CTYPES = {
    Scalar.BOOL: "c_bool",
    Scalar.INT8: "c_int8",
    Scalar.UINT8: "c_uint8",
    Scalar.INT16: "c_int16",
    Scalar.UINT16: "c_uint16",
    Scalar.INT32: "c_int32",
    Scalar.UINT32: "c_uint32",
    Scalar.INT64: "c_int64",
    Scalar.UINT64: "c_uint64",
    Scalar.FLOAT32: "c_float",
    Scalar.FLOAT64: "c_double",
}
_CLOCK_CTYPES = {"TIME": "ctypes.c_uint32", "LTIME": "ctypes.c_uint64", "struct": "ctypes.c_uint32 * 2"}


class Line(NamedTuple):
    """`name: type = value`, as much of it as the place that prints it needs."""

    name: str
    type: str = ""
    value: str = ""


def is_shown(slot: Slot) -> bool:
    """Whether the class shows the member otherwise than ctypes does: arrays, text and times."""
    return slot.count is not None or not isinstance(slot.type, Scalar | Ref)


def stored_name(slot: Slot) -> str:
    if slot.role is Role.DATA:
        stored = ("_" if is_shown(slot) else "") + python_member(slot.name)
        return f"{stored}_stored" if stored in PYTHON_STORED else stored
    return f"_{slot.name}"  # with two underscores for padding: `_pad0` may be how a string `pad0` is stored


def ctype(slot: Slot, options: TypeOptions, names: Mapping[TypeName, str]) -> str:
    many = "" if slot.count is None else f" * {slot.count}"
    return _element_ctype(slot.type, options, names) + many


def _element_ctype(type_: Element, options: TypeOptions, names: Mapping[TypeName, str]) -> str:
    match type_:
        case Scalar():
            return f"ctypes.{CTYPES[type_]}"
        case Clock():
            return _CLOCK_CTYPES[options.time]
        case String(capacity, wide):
            return f"ctypes.{'c_uint16' if wide else 'c_char'} * {(capacity or 0) + 1}"
        case Ref(name):
            return names[name]
        case _:
            assert_never(type_)


def annotation(type_: Element, names: Mapping[TypeName, str]) -> str:
    match type_:
        case Scalar():
            return "bool" if type_ is Scalar.BOOL else "float" if type_.is_float else "int"
        case Ref(name):
            return names[name]
        case Clock() | String():
            raise AssertionError("shown by a descriptor")
        case _:
            assert_never(type_)


def descriptor(slot: Slot, options: TypeOptions, names: Mapping[TypeName, str], count_at: int | None) -> str:
    counted = "" if count_at is None else f", count_at={count_at}"
    match slot.type:
        case String(capacity, _):
            ways = f"{codec.text_in(slot.type, options)}, {codec.text_out(slot.type, options)}"
            if slot.count is None:
                return f"runtime.Text({slot.offset}, {slot.size}, {capacity}, {ways})"
            return f"runtime.Texts({slot.offset}, {slot.element_size}, {capacity}, {slot.count}, {ways}{counted})"
        case Clock():
            code = f'"{codec.CLOCK_CODES[options.time]}"'
            ways = f"{codec.clock_in(slot.type, options)}, {codec.clock_out(slot.type, options)}"
            if slot.count is None:
                return f"runtime.Clock({slot.offset}, {code}, {ways})"
            return f"runtime.Clocks({slot.offset}, {code}, {slot.count}, {ways}{counted})"
        case Scalar() | Ref():
            kind = _element_ctype(slot.type, options, names)
            return f"runtime.Elements({slot.offset}, {kind}, {slot.count}{counted})"
        case _:
            assert_never(slot.type)


def hiding(annotations: list[Line], assigned: list[Line], used: Set[str]) -> Iterator[str]:
    """What is named like something the class body uses: last, in one assignment, and `int` after what is one."""
    hidden = [row for row in assigned if row.name in used]
    if hidden:
        yield f"{', '.join(row.name for row in hidden)} = {', '.join(row.value for row in hidden)}"
    annotated = [row for row in annotations if row.name in used]
    yield from (f"{row.name}: {row.type}" for row in sorted(annotated, key=lambda row: row.name in ("float", "int")))
