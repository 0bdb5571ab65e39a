"""Generate `shmgen.h`, the C header with the byte layout of a region and the protocol's constants.

All other headers include this file. The layout comes from `core/abi.py`. The header asserts the offset of every field
in the header of a region and of a slot.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from shmgen.core import abi
from shmgen.core.abi import HeaderField
from shmgen.core.model import Output

_TYPES = {"u8": "uint8_t", "char": "char", "u16": "uint16_t", "u32": "uint32_t", "u64": "uint64_t"}


class Member(NamedTuple):
    """A member of a structure. `line` is the declaration with a comment. Offset and size are in bytes."""

    line: str
    name: str
    offset: str
    size: str


class Struct(NamedTuple):
    name: str
    size: str
    members: tuple[Member, ...]


class Region(NamedTuple):
    """The template data for `shmgen.h`. `constants` has one line of C for each constant."""

    abi: str
    constants: tuple[str, ...]
    structs: tuple[Struct, ...]


def plan(package: str, header: Sequence[HeaderField] = abi.HEADER, key: str = "c") -> Output:
    """Plan the header `<key>/<package>/shmgen.h`. `key` is the target whose folder contains the header."""
    view = Region(
        str(abi.ABI),
        _columns([(f"#define SHMGEN_{number.name} {_value(number.value)}", number.meaning) for number in abi.NUMBERS]),
        (_struct("shmgen_region", header, abi.HEADER_SIZE), _struct("shmgen_slot", abi.SLOT, abi.SLOT_HEADER)),
    )
    return Output(f"{key}/{package}/shmgen.h", "c/shmgen.h.j2", view)


def _struct(name: str, words: Sequence[HeaderField], size: int) -> Struct:
    all_fields = list(abi.with_reserved(words, size))
    lines = _columns([(_declaration(word), f"{word.offset}: {word.meaning}") for word in all_fields])
    members = (
        Member(line, word.name, str(word.offset), str(word.size)) for line, word in zip(lines, all_fields, strict=True)
    )
    return Struct(name, str(size), tuple(members))


def _declaration(word: HeaderField) -> str:
    many = f"[{word.length}]" if word.type.endswith("]") else ""
    return f"{_TYPES[word.element]} {word.name}{many};"


def _columns(rows: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Return lines with code and comment in aligned columns. Hexadecimal numbers are converted to C's notation."""
    column = max(len(code) for code, _ in rows)
    return tuple(f"{code:<{column}} /* {comment.replace('16#', '0x')} */" for code, comment in rows)


def _value(value: int) -> str:
    return f"UINT32_C(0x{value:08X})" if value > 0xFFFF else str(value)
