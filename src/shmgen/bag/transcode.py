"""Turns the bytes of a sample straight into those that ROS 2 sends of it (XCDR1, little-endian): 30 times as fast.

The same as decoding a message and encoding it with `bridge.cdr`, which the tests hold it to. A layout is taken apart
once, into steps that each copy what lies together and is aligned alike.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import cast

from shmgen.model import (
    Clock,
    Layout,
    Layouts,
    Ref,
    Role,
    Scalar,
    Slot,
    String,
    assert_never,
)
from shmgen.runtime import CountExceeded, values

Step = Callable[[bytes | bytearray, int, bytearray], None]
"""Takes the payload, where in it the message begins, and what there is of the CDR, to go on with."""

_ENCAPSULATION = b"\0\1\0\0"
_U32 = struct.Struct("<I")
_CLOCK = struct.Struct("<iI")
_PADS = {align: [bytes(-length % align) for length in range(align)] for align in (1, 2, 4, 8)}
_UNITS = {"TIME": ("milliseconds", "<I"), "LTIME": ("nanoseconds", "<Q"), "struct": ("seconds_nanoseconds", "<iI")}


def encoder(layout: Layout, layouts: Layouts) -> Callable[[bytes | bytearray], bytes]:
    """What makes CDR, encapsulation included, of payloads of that layout; it raises CountExceeded."""
    steps = _steps(layout, layouts)
    if len(steps) == 1 and isinstance(steps[0], _Copy) and steps[0].align * (layout.size // steps[0].align):
        only = steps[0]
        if (only.offset, only.size) == (0, layout.size):
            return lambda data: _ENCAPSULATION + data

    def encode(data: bytes | bytearray) -> bytes:
        out = bytearray()
        for step in steps:
            step(data, 0, out)
        return _ENCAPSULATION + out

    return encode


class _Copy:
    """Numbers of one size that lie one behind the other."""

    __slots__ = ("align", "offset", "pads", "size")

    def __init__(self, offset: int, size: int, align: int) -> None:
        self.offset, self.size, self.align, self.pads = offset, size, align, _PADS[align]

    def __call__(self, data: bytes | bytearray, base: int, out: bytearray) -> None:
        start = base + self.offset
        out += self.pads[len(out) % self.align] + data[start : start + self.size]


def _steps(layout: Layout, layouts: Layouts, base: int = 0) -> list[Step]:
    """Of a message whose first byte is `base` bytes behind that of the one it is part of."""
    steps: list[Step] = []
    count_at: int | None = None
    for slot in layout.slots:
        if slot.role is Role.COUNT:
            count_at = base + slot.offset
        elif slot.role is Role.FILLER:
            steps.append(_zero)
        elif slot.role is Role.DATA:
            found = _field(slot, layout, layouts, base, count_at)
            count_at = None
            if steps and len(found) >= 1 and _follows(steps[-1], found[0]):
                former, first = cast(_Copy, steps.pop()), cast(_Copy, found[0])
                found = [_Copy(former.offset, former.size + first.size, former.align), *found[1:]]
            steps += found
    return steps


def _follows(former: Step, step: Step) -> bool:
    return (
        isinstance(former, _Copy)
        and isinstance(step, _Copy)
        and (former.align, former.offset + former.size) == (step.align, step.offset)
    )


def _field(slot: Slot, layout: Layout, layouts: Layouts, base: int, count_at: int | None) -> list[Step]:
    offset = base + slot.offset
    if count_at is None and slot.count is None and isinstance(slot.type, Ref):
        return _steps(layouts[slot.type.name], layouts, offset)
    many = _elements(slot, layout, layouts)
    if count_at is None:
        if isinstance(slot.type, Scalar) and slot.type is not Scalar.BOOL:
            return [_Copy(offset, slot.size, slot.type.size)]
        number = 1 if slot.count is None else slot.count
        return [lambda data, start, out: many(data, start + offset, out, number)]
    at, capacity, name = count_at, slot.count or 0, slot.name

    def counted(data: bytes | bytearray, start: int, out: bytearray) -> None:
        (number,) = _U32.unpack_from(data, start + at)
        if number > capacity:
            raise CountExceeded(name, f"the writer says {number:,} elements; the bound is {capacity:,}")
        out += _PADS[4][len(out) % 4] + _U32.pack(number)
        many(data, start + offset, out, number)

    return [counted]


_Many = Callable[[bytes | bytearray, int, bytearray, int], None]
"""Takes also how many elements there are, and where the first of them begins."""


def _elements(slot: Slot, layout: Layout, layouts: Layouts) -> _Many:
    match slot.type:
        case Scalar.BOOL:
            return _bools
        case Scalar() as scalar:
            return _numbers(scalar.size)
        case Clock():
            return _clocks(slot.type, layout)
        case String():
            return _texts(slot.type, layout, slot.element_size)
        case Ref(name):
            inner, size = _steps(layouts[name], layouts), slot.element_size

            def messages(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
                for start in range(at, at + number * size, size):
                    for step in inner:
                        step(data, start, out)

            return messages
        case _:
            assert_never(slot.type)


def _zero(data: bytes | bytearray, base: int, out: bytearray) -> None:
    """The byte of a message without fields."""
    out.append(0)


def _bools(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
    out += bytes(map(bool, data[at : at + number]))


def _numbers(size: int) -> _Many:
    pads = _PADS[size]

    def numbers(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
        if number:
            out += pads[len(out) % size] + data[at : at + number * size]

    return numbers


def _clocks(clock: Clock, layout: Layout) -> _Many:
    units, code = _UNITS[layout.options.time]
    convert, kept = getattr(values, f"{clock.value}_from_{units}"), struct.Struct(code)

    def clocks(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
        if number:
            out += _PADS[4][len(out) % 4]
        for start in range(at, at + number * kept.size, kept.size):
            out += _CLOCK.pack(*convert(*kept.unpack_from(data, start)))

    return clocks


def _texts(string: String, layout: Layout, size: int) -> _Many:
    pads = _PADS[4]
    name = "from_wide" if string.wide else {"utf-8": "from_text", "latin-1": "from_latin1"}[layout.options.encoding]
    decode = getattr(values, name)

    def texts(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
        for start in range(at, at + number * size, size):
            text = decode(data[start : start + size])
            if string.wide:  # four bytes a unit, as rosidl's code for Fast DDS has them
                kept = b"".join(text.encode("utf-16-le")[i : i + 2] + b"\0\0" for i in range(0, 2 * _units(text), 2))
                out += pads[len(out) % 4] + _U32.pack(len(kept) // 4) + kept
            else:
                kept = text.encode() + b"\0"
                out += pads[len(out) % 4] + _U32.pack(len(kept)) + kept

    return texts


def _units(text: str) -> int:
    return len(text.encode("utf-16-le")) // 2
