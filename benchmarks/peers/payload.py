"""The time in the bytes of a message, for peers that carry bytes: the least that a user would do too."""

from __future__ import annotations

import ctypes
import functools
import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from publish import Pose as Generated

STAMP = struct.Struct("<Q")
POSE = struct.Struct("<7d")


class Pose(ctypes.LittleEndianStructure):
    """56 bytes, where a peer has messages of its own; `x` carries the stamp."""

    _pack_ = 1
    _fields_ = (("x", ctypes.c_double), ("others", ctypes.c_double * 6))


@functools.cache
def block(size: int) -> Any:
    """What all others are."""
    body = {"_pack_": 1, "_fields_": (("stamp", ctypes.c_uint64), ("data", ctypes.c_uint8 * (size - 8)))}
    return type("Block", (ctypes.LittleEndianStructure,), body)


def filler(size: int) -> Callable[[Any, int], None]:
    """From an object with ROS's attributes straight into such a structure, wherever it lies."""
    if size == 56:
        message = pose()

        def fill(into: Any, stamp: int) -> None:
            p, q = message.position, message.orientation
            p.x = float(stamp)
            POSE.pack_into(into, 0, p.x, p.y, p.z, q.x, q.y, q.z, q.w)

        return fill
    data = bytes(size - 8)

    def fill_block(into: Any, stamp: int) -> None:
        into.stamp = stamp
        ctypes.memmove(into.data, data, size - 8)

    return fill_block


def encoder(size: int) -> Callable[[int], bytes]:
    """From an object with ROS's attributes: 56 bytes are a Pose, more are a stamp and what follows."""
    if size != 56:
        block = SimpleNamespace(stamp=0, data=bytes(size - 8))

        def encode_block(stamp: int) -> bytes:
            block.stamp = stamp
            return STAMP.pack(block.stamp) + block.data

        return encode_block
    message = pose()

    def encode(stamp: int) -> bytes:
        p, q = message.position, message.orientation
        p.x = float(stamp)
        return POSE.pack(p.x, p.y, p.z, q.x, q.y, q.z, q.w)

    return encode


def decoder(size: int) -> Callable[[bytes], int]:
    """Into a message object, of which the stamp is read; 1 MiB stays the bytes that came, without a second copy."""
    if size == 320:
        kind = block(size)
        return lambda data: int(kind.from_buffer_copy(data).stamp)
    if size != 56:
        return lambda data: int(STAMP.unpack_from(data)[0])
    return lambda data: int(Generated.from_buffer_copy(data).position.x)


def touched(data: Any) -> None:
    """Looks at all bytes where they lie, eight at a time, as a program does that uses them."""
    import numpy

    numpy.frombuffer(data, numpy.uint64).max()


def pose() -> Any:
    """As a message of rclpy, without rclpy."""
    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    return SimpleNamespace(position=SimpleNamespace(x=0.0, y=2.0, z=3.0), orientation=turn)
