"""Turns a layout into the 192 bytes at the start of its region, and those bytes back into words (ABI 1)."""

from __future__ import annotations

import struct
from typing import NamedTuple

from shmgen.runtime.legible import legible

MAGIC = 0x474D4853
"""`SHMG`, written last: a region without it is still being made."""
ABI = 1
HEADER_SIZE = 192
PAGE = 4096
"""Regions take whole pages, so that a runtime that compares sizes exactly and one that rounds agree."""
SLOT_HEADER = 16
"""Bytes before the payload of a slot: u64 stamp_ns, u32 number, u32 0."""
PLC = 0xFFFFFFFF
"""What a PLC, which knows no process id, writes as `writer` and `lock_holder`."""
LAST = 0xFFFFFFFF
"""The greatest sequence number; after it comes `slots`, which keeps the slot order and never gives 0."""

# Where the words that change stand, in steps of four bytes.
WRITER = 24 // 4
BEGUN = 128 // 4
COMPLETED = 132 // 4
HEARTBEAT = 152 // 4
LOCK_HOLDER = 156 // 4
RECOVERIES = 160 // 4
ARMED = 164 // 4
LOCK_COUNT = 168 // 4
MISSED = 172 // 4

_FIXED = struct.Struct("<IHHQIIII64s")
_MOVING = struct.Struct("<II16xIIIIII")


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
        return (*self[:7], *self[8:10])

    def __str__(self) -> str:
        if self.magic != MAGIC:
            return f"no shmgen region (magic 16#{self.magic:08X}), {self.size} bytes"
        return (
            f"{self.type_name or 'unnamed type'}, {self.payload_size} bytes, digest 16#{self.digest:016X}, "
            f"{self.slots} slots of {self.slot_size} bytes, {self.size} bytes in all, ABI {self.abi}"
        )


def header_for(type_name: str, digest: int, payload_size: int, depth: int) -> Header:
    """The header of a fresh region.

    `depth` is how many samples a slow reader can still fetch; slots = the power of two above it, so that
    a sample stays while the next `depth` are written. Raises ValueError for a depth outside 1 .. 65535.
    """
    if not 1 <= depth <= 65535:
        raise ValueError(f"depth is {depth}; it goes from 1 to 65535 samples")
    slots = 1 << depth.bit_length()
    slot_size = _round_up(SLOT_HEADER + payload_size, 64)
    size = _round_up(HEADER_SIZE + slots * slot_size, PAGE)
    # 63 bytes at most, so that readers in C and ST always find the terminating NUL.
    name = type_name.encode()[:63].decode(errors="ignore")
    return Header(size, MAGIC, ABI, HEADER_SIZE, digest, payload_size, slot_size, 0, slots, name)


def pack(header: Header) -> bytes:
    """The first 96 bytes: what never changes, and `writer`."""
    *numbers, type_name = header[1:10]
    return _FIXED.pack(*numbers, str(type_name).encode())


def unpack(data: bytes, size: int) -> Header:
    """The header in the first 192 bytes of a region of `size` bytes; fewer bytes are read as if 0 followed."""
    data = data.ljust(HEADER_SIZE, b"\0")
    *numbers, type_name = _FIXED.unpack_from(data)
    # Only ASCII can be a type's name; whatever else a damaged or a foreign header holds must not reach a terminal.
    name = legible(type_name.partition(b"\0")[0].decode("ascii", errors="backslashreplace"))
    fields = (size, *numbers, name, *_MOVING.unpack_from(data, 128))
    return Header(*fields)


def steps(older: int, newer: int, slots: int) -> int:
    """How many samples later number `newer` was written than `older`: 0 .. slots - 1 do not come again."""
    return newer - older if newer >= older else newer - older + 2**32 - slots


def _round_up(size: int, step: int) -> int:
    return -(-size // step) * step
