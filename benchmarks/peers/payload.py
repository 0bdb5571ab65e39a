"""Turns a time into the bytes of a message and back, for peers that carry bytes: the least that a user would do too."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from publish import Pose

STAMP = struct.Struct("<Q")
POSE = struct.Struct("<7d")


class Block(ctypes.LittleEndianStructure):
    """What 320 bytes are."""

    _pack_ = 1
    _fields_ = (("stamp", ctypes.c_uint64), ("data", ctypes.c_uint8 * 312))


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
        return lambda data: int(Block.from_buffer_copy(data).stamp)
    if size != 56:
        return lambda data: int(STAMP.unpack_from(data)[0])
    return lambda data: int(Pose.from_buffer_copy(data).position.x)


def pose() -> Any:
    """As a message of rclpy, without rclpy."""
    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    return SimpleNamespace(position=SimpleNamespace(x=0.0, y=2.0, z=3.0), orientation=turn)
