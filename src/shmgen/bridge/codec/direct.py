"""Converts samples directly to serialized ROS messages and back, without a ROS message object in between."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any

from shmgen.runtime import Message, Time
from shmgen.runtime.engine import codec
from shmgen.runtime.messages import wire

_LARGE = 4096
"""The size of a sample in bytes from which copying its arrays dominates the conversion time."""


class WireFormat(Enum):
    """The serialization format of a ROS version."""

    CDR = "ROS 2"
    ROS1 = "ROS 1"


class Transcoder:
    """Converts the samples of one message class to serialized ROS messages of one wire format, and back."""

    def __init__(
        self, kind: type[Message], wire_format: WireFormat = WireFormat.CDR, stamp: tuple[str, ...] = ()
    ) -> None:
        """Prepare the conversion of samples of the class `kind`. `stamp` is the path to the field with the time stamp.

        If this field is zero, `encode` replaces it by the current time.
        """
        self._ros1, table = wire_format is WireFormat.ROS1, codec(kind)
        self._to_wire = table.to_wire if table else partial(wire.to_wire, kind)
        self._from_wire = table.from_wire if table else partial(wire.from_wire, kind)
        self._stamp = _part_of(kind, stamp)

    def encode(self, payload: bytes | bytearray, now: Callable[[], Time] = Time) -> bytes:
        """Return the serialized message for `payload`, the bytes of a sample. `now` gives the time for an unset stamp.

        Raises ValueRejected if a value is invalid.
        """
        at, time = -1, Time()
        if self._stamp and not any(payload[self._stamp]):
            at, time = self._stamp.start, now()
        data: bytes = self._to_wire(payload, self._ros1, False, at, *time)
        return data

    def decode(self, data: bytes) -> bytearray:
        """Convert `data`, a serialized message, to the bytes of a sample.

        Raises ValueError if the bytes are not a message of this type, ValueRejected if the message does not fit.
        """
        payload: bytearray = self._from_wire(data, self._ros1)
        return payload


@dataclass(frozen=True, slots=True)
class DirectPath:
    """Creates functions that convert a topic's samples to serialized messages and back.

    `kind` is the class of the samples. `stamp` is the field path to the time stamp. The ROS time replaces a zero time
    stamp.
    """

    kind: type[Message]
    stamp: tuple[str, ...] = ()

    def decoder_to_sample(self, wire_format: WireFormat) -> Callable[[bytes], Message | None]:
        """Return a function that converts a serialized message to a sample.

        The function returns None if the conversion fails. The caller then decodes the bytes to a ROS message, which
        raises an error that names the fault.
        """
        decode, make = Transcoder(self.kind, wire_format).decode, self.kind.from_buffer

        def message(data: bytes) -> Message | None:
            try:
                return make(decode(data))
            except ValueError:
                return None

        return message

    def encoder_from_sample(self, wire_format: WireFormat, now: Callable[[], Time]) -> Callable[[bytes], bytes]:
        """Return a function that serializes the bytes of a sample. It raises ValueRejected if a value is invalid."""
        return partial(Transcoder(self.kind, wire_format, self.stamp).encode, now=now)


def direct_codec(kind: type[Message], stamp: tuple[str, ...]) -> DirectPath | None:
    """Return the direct conversion of samples to ROS bytes, or None for large messages such as images.

    For large messages the direct conversion would not be faster.
    """
    return None if ctypes.sizeof(kind) >= _LARGE else DirectPath(kind, stamp)


def _part_of(kind: Any, path: tuple[str, ...]) -> slice | None:
    """Return the byte range of the field at `path` in a message of class `kind`, or None if `path` is empty."""
    offset = 0
    for name in path:
        step = next(step for step in kind._steps_ if step.name == name)
        kind, offset = step.kind, offset + step.offset
    return slice(offset, offset + step.size) if path else None
