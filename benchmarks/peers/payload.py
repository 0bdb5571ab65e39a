"""Encodes and decodes the messages for libraries that transfer bytes, with the least work that a user needs."""

from __future__ import annotations

import ctypes
import functools
import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from publish import Pose as GeneratedPose

STAMP = struct.Struct("<Q")
POSE = struct.Struct("<7d")


class Pose(ctypes.LittleEndianStructure):
    """A message of 56 bytes for libraries with typed messages. `x` contains the stamp."""

    _pack_ = 1
    _fields_ = (("x", ctypes.c_double), ("others", ctypes.c_double * 6))


@functools.cache
def block(size: int) -> Any:
    """Return the structure of a message that is not a Pose: a stamp and an array, `size` bytes in total."""
    body = {"_pack_": 1, "_fields_": (("stamp", ctypes.c_uint64), ("data", ctypes.c_uint8 * (size - 8)))}
    return type("Block", (ctypes.LittleEndianStructure,), body)


def filler(size: int) -> Callable[[Any, int], None]:
    """Return a function that writes a message with a stamp directly into a structure in memory."""
    if size == 56:
        message = pose()

        def fill(target: Any, stamp: int) -> None:
            p, q = message.position, message.orientation
            p.x = float(stamp)
            POSE.pack_into(target, 0, p.x, p.y, p.z, q.x, q.y, q.z, q.w)

        return fill
    data = bytes(size - 8)

    def fill_block(target: Any, stamp: int) -> None:
        target.stamp = stamp
        ctypes.memmove(target.data, data, size - 8)

    return fill_block


def encoder(size: int) -> Callable[[int], bytes]:
    """Return a function that encodes a message with a stamp: a Pose for 56 bytes, otherwise a stamp and an array."""
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
    """Return a function that decodes a message and returns its stamp. 1 MiB stays as bytes, without a second copy."""
    if size == 320:
        structure = block(size)
        return lambda data: int(structure.from_buffer_copy(data).stamp)
    if size != 56:
        return lambda data: int(STAMP.unpack_from(data)[0])
    return lambda data: int(GeneratedPose.from_buffer_copy(data).position.x)


def read_all_bytes(data: Any) -> None:
    """Read all bytes of a sample in place, eight at a time, like a program that uses the bytes."""
    import numpy

    numpy.frombuffer(data, numpy.uint64).max()


def pose() -> Any:
    """Return a Pose with the attributes of an rclpy message, without rclpy."""
    orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    return SimpleNamespace(position=SimpleNamespace(x=0.0, y=2.0, z=3.0), orientation=orientation)
