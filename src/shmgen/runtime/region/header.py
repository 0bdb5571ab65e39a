"""The header of a region: its bytes for a layout, and its words out of bytes (ABI 2: core/abi.py)."""

from __future__ import annotations

import struct
from collections import namedtuple
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from shmgen.core import abi
from shmgen.core.abi import ABI, HEADER_SIZE, LAST, MAGIC, PAGE, PLC, SLOT_HEADER, Word
from shmgen.core.escape import legible
from shmgen.core.plural import counted

__all__ = ["ABI", "HEADER_SIZE", "LAST", "MAGIC", "PAGE", "PLC", "SLOT_HEADER"]  # for those who say h.LAST

_AT = {word.name: word.offset for word in (*abi.HEADER, *abi.SLOT)}

# Where the words that change stand, in steps of four bytes: WRITER, TURN and so on, as the table names them.
globals().update((word.name.upper(), word.offset // 4) for word in abi.HEADER if word.by != abi.CREATOR)
if TYPE_CHECKING:

    def __getattr__(name: str) -> int: ...


# And of a slot in steps of eight.
STAMP = _AT["stamp_ns"] // 8
NUMBER = _AT["number"] // 8
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


if TYPE_CHECKING:

    class _Words(NamedTuple):
        size: int
        type_name: str

        def __getattr__(self, name: str) -> int: ...
else:
    _Words = namedtuple("_Words", ("size", *_NAMES))


class Header(_Words):
    """A region's header at one instant: the words of the table, and `size`, that of the whole object in bytes."""

    __slots__ = ()

    @property
    def fixed(self) -> tuple[int | str, ...]:
        """All that both sides must agree on."""
        return (self.size, *(getattr(self, word.name) for word in _MADE))

    @property
    def newest(self) -> int:
        """Number of the newest sample, 0 = none yet."""
        return later(self.completed0, self.completed1)

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
    if len(type_name.encode()) > abi.MAX_TYPE_NAME:
        raise ValueError(f"type {type_name} is longer than the {abi.MAX_TYPE_NAME} bytes a region has for its name")
    slots = abi.slots_for(depth)
    said: dict[str, int | str] = {
        "magic": MAGIC,
        "abi": ABI,
        "header_size": HEADER_SIZE,
        "digest": digest,
        "payload_size": payload_size,
        "slot_size": abi.slot_size(payload_size),
        "slots": slots,
        "type_name": type_name,
    }
    return Header._make((abi.region_size(payload_size, slots), *(said.get(name, 0) for name in _NAMES)))


def pack(header: Header) -> bytes:
    """The bytes of a header."""
    return _HEADER.pack(*(value.encode() if isinstance(value, str) else value for value in header[1:]))


def unpack(data: bytes, size: int) -> Header:
    """The header at the start of a region of `size` bytes; missing bytes are read as 0."""
    values = _HEADER.unpack(data[:HEADER_SIZE].ljust(HEADER_SIZE, b"\0"))
    return Header._make((size, *(_text(value) if isinstance(value, bytes) else value for value in values)))


def later(one: int, other: int) -> int:
    """The later of two numbers of samples, of which 0 is none."""
    return other if other and (not one or (other - one & LAST) < abi.RESTART_GAP) else one


def lane(turn: int) -> int:
    """The lane of a turn."""
    return turn >> 1 & 1


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
