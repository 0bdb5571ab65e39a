"""Converts samples directly to serialized ROS messages and back, without a ROS message object in between."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from typing import Any

from shmgen.runtime import Message, Time
from shmgen.runtime.engine import codec
from shmgen.runtime.messages import wire

_LARGE = 4096
"""The size of a sample in bytes from which copying its arrays dominates the conversion time."""


class Transcoder:
    """Converts the samples of one message class to serialized ROS messages, and back."""

    __slots__ = ("_from_wire", "_kind", "_stamp_at", "_to_wire")

    def __init__(self, kind: type[Message], stamp: tuple[str, ...] = ()) -> None:
        """Prepare the conversion. `stamp` is the path to the time stamp. encode() fills in a time stamp of zero."""
        table = codec(kind)
        self._to_wire = table.to_wire if table else partial(wire.to_wire, kind)
        self._from_wire = table.from_wire if table else partial(wire.from_wire, kind)
        self._kind, self._stamp_at = kind, _offset_of(kind, stamp)

    def encode(
        self,
        payload: bytes | bytearray,
        now: Callable[[], Time] = Time,
        is_ros1: bool = False,
    ) -> bytes:
        """Return the serialized message for `payload`, the bytes of a sample. `now` returns the time for a zero stamp.

        The format is CDR, or the serialization of ROS 1 if `is_ros1` is true.
        Raises ValueRejected if a value is invalid.
        """
        data: bytes = self._to_wire(payload, is_ros1, self._stamp_at, now)
        return data

    def decode(self, data: bytes, is_ros1: bool = False) -> Message | None:
        """Convert a serialized message to a sample. Return None on failure: the caller then uses another decoder."""
        try:  # suppress() would take as long as from_buffer()
            return self._kind.from_buffer(self._from_wire(data, is_ros1))
        except ValueError:
            return None


def direct_codec(kind: type[Message], stamp: tuple[str, ...]) -> Transcoder | None:
    """Return the direct conversion of `kind`, or None for large messages such as images, where it saves no time."""
    return None if ctypes.sizeof(kind) >= _LARGE else Transcoder(kind, stamp)


def _offset_of(kind: Any, path: tuple[str, ...]) -> int:
    """Return the offset in bytes of the field at `path` in a message of class `kind`, or -1 if `path` is empty."""
    offset = 0
    for name in path:
        step = next(step for step in kind._steps_ if step.name == name)
        kind, offset = step.kind, offset + step.offset
    return offset if path else -1
