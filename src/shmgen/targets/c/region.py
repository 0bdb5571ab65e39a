"""Turns the region of abi.py into `shmgen.h`: what all headers share, each word asserted to be where it belongs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from shmgen.core import abi
from shmgen.core.abi import Number, Word
from shmgen.core.model import Output

_TYPES = {"u8": "uint8_t", "char": "char", "u16": "uint16_t", "u32": "uint32_t", "u64": "uint64_t"}


class Member(NamedTuple):
    """`line` declares it and says what it means; offset and size in bytes."""

    line: str
    name: str
    offset: str
    size: str


class Struct(NamedTuple):
    name: str
    size: str
    members: tuple[Member, ...]


class Region(NamedTuple):
    """All of the region; `constants` are lines."""

    abi: str
    constants: tuple[str, ...]
    structs: tuple[Struct, ...]


def plan(
    package: str,
    header: Sequence[Word] = abi.HEADER,
    slot: Sequence[Word] = abi.SLOT,
    numbers: Sequence[Number] = abi.NUMBERS,
    key: str = "c",
) -> Output:
    """`c/<package>/shmgen.h`, or the same for another target's key."""
    view = Region(
        str(abi.ABI),
        _columns([(f"#define SHMGEN_{number.name} {_value(number.value)}", number.meaning) for number in numbers]),
        (_struct("shmgen_region", header, abi.HEADER_SIZE), _struct("shmgen_slot", slot, abi.SLOT_HEADER)),
    )
    return Output(f"{key}/{package}/shmgen.h", "c/shmgen.h.j2", view)


def _struct(name: str, words: Sequence[Word], size: int) -> Struct:
    tiled = list(abi.tiled(words, size))
    lines = _columns([(_declaration(word), f"{word.offset}: {word.meaning}") for word in tiled])
    members = (
        Member(line, word.name, str(word.offset), str(word.size)) for line, word in zip(lines, tiled, strict=True)
    )
    return Struct(name, str(size), tuple(members))


def _declaration(word: Word) -> str:
    many = f"[{word.length}]" if word.type.endswith("]") else ""
    return f"{_TYPES[word.element]} {word.name}{many};"


def _columns(rows: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Code and comment, lined up; hexadecimal numbers as C spells them."""
    column = max(len(code) for code, _ in rows)
    return tuple(f"{code:<{column}} /* {comment.replace('16#', '0x')} */" for code, comment in rows)


def _value(value: int) -> str:
    return f"UINT32_C(0x{value:08X})" if value > 0xFFFF else str(value)
