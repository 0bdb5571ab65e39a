"""Turns a time into the bytes of a message and back, for peers that carry bytes: the least that a user would do too."""

from __future__ import annotations

import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from publish import Pose

STAMP = struct.Struct("<Q")
POSE = struct.Struct("<7d")


def encoder(size: int) -> Callable[[int], bytes]:
    """56 bytes are a Pose, from an object with ROS's attributes; more are a stamp and what follows."""
    if size != 56:
        rest = bytes(size - 8)
        return lambda stamp: STAMP.pack(stamp) + rest
    message = pose()

    def encode(stamp: int) -> bytes:
        p, q = message.position, message.orientation
        p.x = float(stamp)
        return POSE.pack(p.x, p.y, p.z, q.x, q.y, q.z, q.w)

    return encode


def decoder(size: int) -> Callable[[bytes], int]:
    """Into a message object, of which the stamp is read."""
    if size != 56:
        return lambda data: int(STAMP.unpack_from(data)[0])
    return lambda data: int(Pose.from_buffer_copy(data).position.x)


def pose() -> Any:
    """As a message of rclpy, without rclpy."""
    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    return SimpleNamespace(position=SimpleNamespace(x=0.0, y=2.0, z=3.0), orientation=turn)
