"""What ROS 1 and ROS 2 do otherwise where they lay the same fields one behind the other."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from shmgen.core.model import Clock


@dataclass(frozen=True, slots=True)
class WireFormat:
    """`head` goes before a message; its numbers are `aligned` behind that, or not at all; `end` goes after a text.

    `filler` stands for a message without fields; at most `rest` bytes may follow a message. `clocks` are seconds and
    nanoseconds.
    """

    head: bytes
    aligned: bool
    end: bytes
    filler: bytes
    rest: int
    clocks: Mapping[Clock, struct.Struct]

    def pads(self, align: int) -> list[bytes]:
        """What has to go before a number of `align` bytes, by the bytes before it modulo `align`."""
        return [bytes(-length % align if self.aligned else 0) for length in range(align)]


_ROS2 = struct.Struct("<iI")
CDR = WireFormat(b"\0\1\0\0", True, b"\0", b"\0", 3, {Clock.TIME: _ROS2, Clock.DURATION: _ROS2})
"""XCDR1 of OMG's DDS-XTypes, little-endian, as ROS 2 sends it: with what fills it up to four bytes."""
ROS1 = WireFormat(b"", False, b"", b"", 0, {Clock.TIME: struct.Struct("<II"), Clock.DURATION: struct.Struct("<ii")})
"""As genpy packs it."""
