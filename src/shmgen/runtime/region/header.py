"""The header of a region: creating, packing and unpacking it (ABI 2: core/abi.py)."""

from __future__ import annotations

import struct
from collections import namedtuple
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from shmgen.core import abi
from shmgen.core.abi import ABI, HEADER_SIZE, LAST, MAGIC, PLC, SLOT_HEADER, HeaderField
from shmgen.core.escape import legible
from shmgen.core.plural import counted

__all__ = ["ABI", "HEADER_SIZE", "LAST", "MAGIC", "PLC", "SLOT_HEADER"]  # for callers that write h.LAST

_AT = {word.name: word.offset for word in (*abi.HEADER, *abi.SLOT)}

# The positions of the header fields that change, in steps of four bytes: WRITER, TURN and so on.
globals().update((word.name.upper(), word.offset // 4) for word in abi.HEADER if word.by != abi.CREATOR)
if TYPE_CHECKING:

    def __getattr__(name: str) -> int: ...


# The positions of the fields of a slot, in steps of eight bytes.
STAMP = _AT["stamp_ns"] // 8
NUMBER = _AT["number"] // 8
"""The position of the sample number in a slot, together with the four zero bytes after the number."""

_CODES = {"u8": "x", "char": "s", "u16": "H", "u32": "I", "u64": "Q"}


def codes(words: Iterable[HeaderField], size: int) -> str:
    """Return the format of `struct` for the header fields `words`, padded to `size` bytes. Padding gives no value."""
    all_fields = abi.with_reserved(words, size)
    return "<" + "".join(f"{word.length if word.length > 1 else ''}{_CODES[word.element]}" for word in all_fields)


_HEADER = struct.Struct(codes(abi.HEADER, HEADER_SIZE))
_NAMES = tuple(word.name for word in abi.HEADER)
_MADE = tuple(word for word in abi.HEADER if word.by == abi.CREATOR)

MADE = tuple(slice(word.offset, word.offset + word.size) for word in _MADE)
"""The slices of a header that the creator of a region writes. The magic comes first."""


if TYPE_CHECKING:

    class _Words(NamedTuple):
        size: int
        type_name: str

        def __getattr__(self, name: str) -> int: ...
else:
    _Words = namedtuple("_Words", ("size", *_NAMES))


class Header(_Words):
    """A region's header at one instant: its fields, and `size`, the size of the whole region in bytes.

    ```python
    header = read_header(region_name("/robot/pose"))
    print(header.type_name, header.samples)
    ```
    """

    __slots__ = ()

    @property
    def fixed(self) -> tuple[int | str, ...]:
        """The size and the header fields that must be equal for all endpoints of a region."""
        return (self.size, *(getattr(self, word.name) for word in _MADE))

    @property
    def newest(self) -> int:
        """The number of the newest sample, or 0 if there is none yet."""
        return later(self.completed0, self.completed1)

    @property
    def samples(self) -> int:
        """The number of samples written so far. In a request region, the number since its creation or last takeover.

        The numbers of requests begin at a value of the clock, not at 1.
        """
        begins_at_clock = abi.RESTART_GAP <= self.left <= self.newest
        return self.newest - self.left if begins_at_clock else self.newest

    @property
    def foreign(self) -> bool:
        """True if another program has created the file. False for a magic number of 0: the file may become a region."""
        return self.magic not in (0, MAGIC)

    def __str__(self) -> str:
        if self.magic != MAGIC:
            return f"not a region of shmgen (magic 16#{self.magic:08X}), {counted(self.size, 'byte')}"
        return (
            f"{self.type_name or 'unnamed type'}, {counted(self.payload_size, 'byte')}, digest 16#{self.digest:016X}, "
            f"{self.slots} slots of {self.slot_size} bytes, {counted(self.size, 'byte')} in all, ABI {self.abi}"
        )


def header_for(type_name: str, digest: int, payload_size: int, depth: int) -> Header:
    """Return the header of a new region.

    `depth` is the number of newest samples that the region keeps for slow readers. Raises ValueError if the depth is
    not in 1 .. 65535, or if the type name has more than 95 bytes.
    """
    if len(type_name.encode()) > abi.MAX_TYPE_NAME:
        raise ValueError(f"type {type_name} is longer than the {abi.MAX_TYPE_NAME} bytes a region has for its name")
    slots = abi.slots_for(depth)
    fields: dict[str, int | str] = {
        "magic": MAGIC,
        "abi": ABI,
        "header_size": HEADER_SIZE,
        "digest": digest,
        "payload_size": payload_size,
        "slot_size": abi.slot_size(payload_size),
        "slots": slots,
        "type_name": type_name,
    }
    return Header._make((abi.region_size(payload_size, slots), *(fields.get(name, 0) for name in _NAMES)))


def pack(header: Header) -> bytes:
    """Return the bytes of a header."""
    return _HEADER.pack(*(value.encode() if isinstance(value, str) else value for value in header[1:]))


def unpack(data: bytes, size: int) -> Header:
    """Return the header at the start of a region of `size` bytes. Missing bytes are read as 0."""
    values = _HEADER.unpack(data[:HEADER_SIZE].ljust(HEADER_SIZE, b"\0"))
    return Header._make((size, *(_text(value) if isinstance(value, bytes) else value for value in values)))


def later(one: int, other: int) -> int:
    """Return the later of two sample numbers, which may have wrapped around. 0 means no sample."""
    return other if other and (not one or (other - one & LAST) < abi.RESTART_GAP) else one


def lane(turn: int) -> int:
    """Return the lane, 0 or 1, of the writer that has set the header field `turn` to this value.

    A lane is one half of the region's slots. A writer that takes over from a stopped writer uses the other lane.
    """
    return turn >> 1 & 1


def after(number: int, steps: int, slots: int) -> int:
    """Return the number of the sample `steps` samples after `number`.

    After LAST, the largest number, the numbers restart at `slots`, the number of slots in a lane.
    """
    number += steps
    return number if number <= LAST else number - 2**32 + slots


def steps(older: int, newer: int, slots: int) -> int:
    """Return the number of samples from `older` to `newer`: 1 if `newer` is the next sample after `older`.

    The numbers 0 to slots - 1 are not used again after the numbers wrap around.
    """
    return newer - older if newer >= older else newer - older + 2**32 - slots


def _text(data: bytes) -> str:
    """Return a type name in ASCII, with escapes for all other bytes.

    A damaged header, or the header of another program, may contain bytes that must not reach a terminal.
    """
    return legible(data.partition(b"\0")[0].decode("ascii", errors="backslashreplace"))
