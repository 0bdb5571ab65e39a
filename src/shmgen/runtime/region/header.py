"""Turns a layout into the header of its region, and the bytes of a header back into words (ABI 1: core/abi.py)."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any, NamedTuple

from shmgen.core import abi
from shmgen.core.abi import ABI, HEADER_SIZE, LAST, MAGIC, PAGE, PLC, SLOT_HEADER, Word
from shmgen.core.escape import legible
from shmgen.core.plural import counted

__all__ = ["ABI", "HEADER_SIZE", "LAST", "MAGIC", "PAGE", "PLC", "SLOT_HEADER"]  # for those who say h.LAST

_AT = {word.name: word.offset for word in abi.HEADER}
_IN_SLOT = {word.name: word.offset for word in abi.SLOT}

# Where the words that change stand, in steps of four bytes.
WRITER = _AT["writer"] // 4
BEGUN = _AT["begun"] // 4
COMPLETED = _AT["completed"] // 4
HEARTBEAT = _AT["heartbeat"] // 4
LOCK_HOLDER = _AT["lock_holder"] // 4
RECOVERIES = _AT["recoveries"] // 4
ARMED = _AT["armed"] // 4
LOCK_COUNT = _AT["lock_count"] // 4
MISSED = _AT["missed"] // 4

# And in steps of eight, for two words in one look.
RECOVERIES_ARMED = _AT["recoveries"] // 8
STAMP = _IN_SLOT["stamp_ns"] // 8
NUMBER = _IN_SLOT["number"] // 8
"""With the four bytes of 0 behind it."""

_CODES = {"u8": "x", "char": "s", "u16": "H", "u32": "I", "u64": "Q"}


def codes(words: Iterable[Word], size: int) -> str:
    """What `struct` calls them, one value for each word that is not reserved."""
    tiled = abi.tiled(words, size)
    return "<" + "".join(f"{word.length if word.length > 1 else ''}{_CODES[word.element]}" for word in tiled)


_HEADER = struct.Struct(codes(abi.HEADER, HEADER_SIZE))
_NAMES = tuple(word.name for word in abi.HEADER)
_MADE = tuple(word for word in abi.HEADER if word.by == abi.CREATOR)

MADE = tuple(slice(word.offset, word.offset + word.size) for word in _MADE)
"""Where in a header the words stand that whoever makes a region writes, the magic first."""


class Header(NamedTuple):
    """A region's header at one instant; `size` is that of the whole object in bytes."""

    size: int
    magic: int
    abi: int
    header_size: int
    digest: int
    payload_size: int
    slot_size: int
    writer: int
    slots: int
    type_name: str
    begun: int = 0
    completed: int = 0
    heartbeat: int = 0
    lock_holder: int = 0
    recoveries: int = 0
    armed: int = 0
    lock_count: int = 0
    missed: int = 0

    @property
    def fixed(self) -> tuple[int | str, ...]:
        """All that both sides must agree on."""
        return (self.size, *(getattr(self, word.name) for word in _MADE))

    @property
    def foreign(self) -> bool:
        """Something else has made the file; without a magic it may become a region."""
        return self.magic not in (0, MAGIC)

    def __str__(self) -> str:
        if self.magic != MAGIC:
            return f"not a region of shmgen (magic 16#{self.magic:08X}), {counted(self.size, 'byte')}"
        return (
            f"{self.type_name or 'unnamed type'}, {counted(self.payload_size, 'byte')}, digest 16#{self.digest:016X}, "
            f"{self.slots} slots of {self.slot_size} bytes, {counted(self.size, 'byte')} in all, ABI {self.abi}"
        )


def header_for(type_name: str, digest: int, payload_size: int, depth: int) -> Header:
    """The header of a fresh region.

    `depth` is how many samples a slow reader can still fetch. Raises ValueError for a depth outside 1 .. 65535 and a
    name of more than 95 bytes.
    """
    slots = abi.slots_for(depth)
    size, slot_size = abi.region_size(payload_size, slots), abi.slot_size(payload_size)
    if len(type_name.encode()) > abi.MAX_TYPE_NAME:
        raise ValueError(f"type {type_name} is longer than the {abi.MAX_TYPE_NAME} bytes a region has for its name")
    return Header(size, MAGIC, ABI, HEADER_SIZE, digest, payload_size, slot_size, 0, slots, type_name)


def pack(header: Header) -> bytes:
    """The bytes of a header."""
    values = (getattr(header, name) for name in _NAMES)
    return _HEADER.pack(*(value.encode() if isinstance(value, str) else value for value in values))


def unpack(data: bytes, size: int) -> Header:
    """The header at the start of a region of `size` bytes; missing bytes are read as 0."""
    found = words(data)
    return Header(size, *(found[name] for name in Header._fields[1:]))


def words(data: bytes) -> dict[str, Any]:
    """Every word of a header by its name: numbers, and `type_name` as text."""
    values = _HEADER.unpack(data[:HEADER_SIZE].ljust(HEADER_SIZE, b"\0"))
    shown = (_text(value) if isinstance(value, bytes) else value for value in values)
    return dict(zip(_NAMES, shown, strict=True))


def after(number: int, steps: int, slots: int) -> int:
    """The number of the sample so many `steps` later."""
    number += steps
    return number if number <= LAST else number - 2**32 + slots


def steps(older: int, newer: int, slots: int) -> int:
    """How many samples later number `newer` was written than `older`: 0 .. slots - 1 do not come again."""
    return newer - older if newer >= older else newer - older + 2**32 - slots


def _text(data: bytes) -> str:
    """Only ASCII can be a type's name; whatever else a damaged or a foreign header holds must not reach a terminal."""
    return legible(data.partition(b"\0")[0].decode("ascii", errors="backslashreplace"))
