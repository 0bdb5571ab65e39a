"""Convert the bytes of a message in a region to a serialized message of ROS, and back.

ROS 2 uses XCDR1 of OMG's DDS-XTypes after a head of four bytes, which contains the byte order. ROS 1 has its own
serialization. The extension does the same in wire.c.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from shmgen.runtime.errors import OutOfRange
from shmgen.runtime.messages.numbers import check_count
from shmgen.runtime.messages.steps import COUNT, STRUCTS, Step
from shmgen.runtime.messages.strings import TEXTS, decode_text
from shmgen.runtime.messages.times import CLOCKS, Time, decode_clock
from shmgen.runtime.messages.walker import encode_element, inside, place

_REST = 3
"""Maximum number of padding bytes after a ROS 2 message, whose size is rounded up to a multiple of four."""


def to_wire(kind: Any, payload: Any, ros1: bool, stamp_at: int, now: Callable[[], tuple[int, int]]) -> bytes:
    """Return a message as ROS serializes it, in little-endian. `payload` has the bytes of the message in a region.

    `kind` is the class of the message. A zero time at byte `stamp_at` is replaced by the seconds and nanoseconds that
    `now` returns. Raises ValueRejected if a value does not fit.
    """
    wire = _Writer(bytes(payload), ros1, stamp_at, now, bytearray())
    wire.message(kind, 0)
    return (b"" if ros1 else b"\0\1\0\0") + wire.out


def from_wire(kind: Any, data: bytes, ros1: bool) -> bytearray:
    """Return the bytes that a region contains for `data`, a message as ROS serializes it.

    `kind` is the class of the message. Raises ValueError if the bytes are not a message of this type, or ValueRejected
    if a value does not fit.
    """
    head, rest = (0, 0) if ros1 else (4, _REST)
    if head and (len(data) < head or data[0] != 0 or data[1] > 1):
        raise ValueError("the bytes are in another encoding")
    wire = _Reader(data[head:], ros1, ">" if head and not data[1] else "<", bytearray(kind._size_))
    wire.message(kind, 0)
    if len(wire.data) - wire.at > rest:
        raise ValueError("the bytes are longer than the message")
    return wire.out


@dataclass
class _Writer:
    payload: bytes
    ros1: bool
    stamp_at: int
    now: Callable[[], tuple[int, int]]
    out: bytearray

    def message(self, kind: Any, base: int) -> None:
        if not kind._steps_ and not self.ros1:
            self.out.append(0)
        for step in kind._steps_:
            count, at = max(1, step.length), base + step.offset
            if step.count_at >= 0:
                (count,) = COUNT.unpack_from(self.payload, base + step.count_at)
                check_count(count, step.length, step.path)
                self.put("I", 4, count)
            if step.kind in STRUCTS:
                self.numbers(step, self.payload[at : at + count * step.size])
                continue
            for index in range(count):
                self.element(step, at + index * step.size, index if step.length else -1)

    def numbers(self, step: Step, data: bytes) -> None:
        if step.kind == "bool":  # a PLC may have written any byte
            data = bytes(map(bool, data))
        if data:
            self.put(f"{len(data)}s", step.size, data)

    def element(self, step: Step, at: int, index: int) -> None:
        data = self.payload[at : at + step.size]
        if step.kind in CLOCKS:
            time = decode_clock(step.kind, data)
            parts = self.now() if at == self.stamp_at and not any(time) else time
            try:
                self.put(_code_of(step, self.ros1), 4, *parts)
            except struct.error:
                raise OutOfRange(place(step, index), "ROS cannot represent this time") from None
        elif step.kind not in TEXTS:
            inside(place(step, index), self.message, step.kind, at)
        elif step.kind.startswith("utf-16"):  # four bytes per unit, as in rosidl's code for Fast DDS
            units = decode_text(step.kind, data).encode("utf-16-le")
            values = struct.unpack(f"<{len(units) // 2}H", units)
            self.put(f"I{len(values)}I", 4, len(values), *values)
        else:
            text = decode_text(step.kind, data).encode() + (b"" if self.ros1 else b"\0")
            self.put(f"I{len(text)}s", 4, len(text), text)

    def put(self, code: str, align: int, *values: Any) -> None:
        if not self.ros1:
            self.out += bytes(-len(self.out) % align)
        self.out += struct.pack(f"<{code}", *values)


@dataclass
class _Reader:
    data: bytes
    ros1: bool
    order: str
    out: bytearray
    at: int = 0

    def message(self, kind: Any, base: int) -> None:
        if not kind._steps_ and not self.ros1:
            self.at += 1
            if self.at > len(self.data):
                raise ValueError("the bytes end within the message")
        for step in kind._steps_:
            count, at = max(1, step.length), base + step.offset
            if step.count_at >= 0:
                (count,) = self.take("I", 4, step, -1)
                check_count(count, step.length, step.path)
                COUNT.pack_into(self.out, base + step.count_at, count)
            if step.kind in STRUCTS:
                self.numbers(step, count, at)
                continue
            for index in range(count):
                self.element(step, at + index * step.size, index if step.length else -1)

    def numbers(self, step: Step, count: int, at: int) -> None:
        if not count:
            return
        (data,) = self.take(f"{count * step.size}s", step.size, step, -1)
        if step.kind == "bool" and (wrong := data.translate(None, b"\0\1")):
            index = data.index(wrong[0]) if step.length else -1
            raise OutOfRange(place(step, index), "the byte is not a bool")
        if self.order == ">":  # swap the bytes without decoding them, so that a signalling NaN keeps all bits
            data = b"".join(data[at : at + step.size][::-1] for at in range(0, len(data), step.size))
        self.out[at : at + len(data)] = data

    def element(self, step: Step, at: int, index: int) -> None:
        path = place(step, index)
        if step.kind in CLOCKS:
            value: Any = Time(*self.take(_code_of(step, self.ros1), 4, step, index))
        elif step.kind not in TEXTS:
            inside(path, self.message, step.kind, at)
            return
        else:
            value = self.text(step, index)
        encode_element(step.kind, value, self.out, at, step.size, path)

    def text(self, step: Step, index: int) -> str:
        (length,) = self.take("I", 4, step, index)
        try:
            if step.kind.startswith("utf-16"):
                return struct.pack(f"<{length}H", *self.take(f"{length}I", 4, step, index)).decode("utf-16-le")
            (data,) = self.take(f"{length}s", 1, step, index)
            if not self.ros1 and not data.endswith(b"\0"):
                raise OutOfRange(place(step, index), "the text does not end in NUL")
            return str(data if self.ros1 else data[:-1], "utf-8")
        except (UnicodeDecodeError, struct.error):
            raise OutOfRange(place(step, index), "the bytes are not valid text") from None

    def take(self, code: str, align: int, step: Step, index: int) -> tuple[Any, ...]:
        if not self.ros1:
            self.at += -self.at % align
        start, self.at = self.at, self.at + struct.calcsize(self.order + code)
        if self.at > len(self.data):
            raise OutOfRange(place(step, index), "the bytes end within this field")
        return struct.unpack_from(self.order + code, self.data, start)


def _code_of(step: Step, ros1: bool) -> str:
    """Return the format of `struct` for a time or duration: seconds, then nanoseconds.

    In ROS 2 the seconds are signed and the nanoseconds unsigned. In ROS 1 both are signed in a duration, and both are
    unsigned in a time.
    """
    if not ros1:
        return "iI"
    return "ii" if step.kind.startswith("duration") else "II"
