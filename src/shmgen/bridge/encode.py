"""Turns the bytes of a sample straight into those that ROS sends of it: 30 times as fast as by way of a message.

The same as decoding a message and encoding it with `bridge.cdr`, or genpy, which the tests hold it to. A layout is
taken apart once, into steps that each copy what lies together and is aligned alike.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from shmgen.bridge.dialect import CDR, Dialect
from shmgen.model import Clock, Layout, Layouts, Ref, Role, Scalar, Slot, String, assert_never
from shmgen.runtime import CountExceeded, Time, values

Step = Callable[[bytes | bytearray, int, bytearray], None]
"""Takes the payload, where in it the message begins, and what there is of ROS's bytes, to go on with."""

UNITS = {"TIME": ("milliseconds", "<I"), "LTIME": ("nanoseconds", "<Q"), "struct": ("seconds_nanoseconds", "<iI")}
"""What the functions in `values` call a time in the region, and struct."""
_U32 = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class Stamp:
    """Where a time is that becomes `now()` if it is zero: the names of the fields that lead to it."""

    path: tuple[str, ...]
    now: Callable[[], Time]


def encoder(
    layout: Layout, layouts: Layouts, dialect: Dialect = CDR, stamp: Stamp | None = None
) -> Callable[[bytes | bytearray], bytes]:
    """What makes ROS's bytes of payloads of that layout; it raises CountExceeded, and struct.error for an odd time."""
    steps = _Steps(layouts, dialect, stamp).of(layout, 0, ())
    head = dialect.head
    if len(steps) == 1 and isinstance(steps[0], _Copy):
        only = steps[0]
        if (only.offset, only.size) == (0, layout.size):
            return lambda data: head + data

    def encode(data: bytes | bytearray) -> bytes:
        out = bytearray()
        for step in steps:
            step(data, 0, out)
        return head + out

    return encode


class _Copy:
    """Numbers of one size that lie one behind the other."""

    __slots__ = ("align", "offset", "pads", "size")

    def __init__(self, offset: int, size: int, align: int, pads: list[bytes]) -> None:
        self.offset, self.size, self.align, self.pads = offset, size, align, pads

    def __call__(self, data: bytes | bytearray, base: int, out: bytearray) -> None:
        start = base + self.offset
        out += self.pads[len(out) % self.align] + data[start : start + self.size]


_Many = Callable[[bytes | bytearray, int, bytearray, int], None]
"""Takes also how many elements there are, and where the first of them begins."""
_NOWHERE = ("",)
"""The path of what is in an array: no stamp."""


class _Steps:
    """What takes layouts apart."""

    def __init__(self, layouts: Layouts, dialect: Dialect, stamp: Stamp | None) -> None:
        self._layouts, self._dialect, self._stamp = layouts, dialect, stamp
        self._pads4 = dialect.pads(4)

    def of(self, layout: Layout, base: int, path: tuple[str, ...]) -> list[Step]:
        """Of a message whose first byte is `base` bytes behind that of the one it is part of, at `path`."""
        steps: list[Step] = []
        count_at: int | None = None
        for slot in layout.slots:
            if slot.role is Role.COUNT:
                count_at = base + slot.offset
            elif slot.role is Role.FILLER:
                steps.append(self._filler)
            elif slot.role is Role.DATA:
                found = self._field(slot, layout, base, count_at, (*path, slot.name))
                count_at = None
                if steps and len(found) >= 1 and _follows(steps[-1], found[0]):
                    former, first = cast(_Copy, steps.pop()), cast(_Copy, found[0])
                    found = [_Copy(former.offset, former.size + first.size, former.align, former.pads), *found[1:]]
                steps += found
        return steps

    def _filler(self, data: bytes | bytearray, base: int, out: bytearray) -> None:
        out += self._dialect.filler

    def _field(self, slot: Slot, layout: Layout, base: int, count_at: int | None, path: tuple[str, ...]) -> list[Step]:
        offset = base + slot.offset
        if count_at is None and slot.count is None and isinstance(slot.type, Ref):
            return self.of(self._layouts[slot.type.name], offset, path)
        many = self._elements(slot, layout, path)
        if count_at is None:
            if isinstance(slot.type, Scalar) and slot.type is not Scalar.BOOL:
                return [_Copy(offset, slot.size, slot.type.size, self._dialect.pads(slot.type.size))]
            number = 1 if slot.count is None else slot.count
            return [lambda data, start, out: many(data, start + offset, out, number)]
        at, capacity, name, pads = count_at, slot.count or 0, slot.name, self._pads4

        def counted(data: bytes | bytearray, start: int, out: bytearray) -> None:
            (number,) = _U32.unpack_from(data, start + at)
            if number > capacity:
                raise CountExceeded(name, f"the writer says {number:,} elements; the bound is {capacity:,}")
            out += pads[len(out) % 4] + _U32.pack(number)
            many(data, start + offset, out, number)

        return [counted]

    def _elements(self, slot: Slot, layout: Layout, path: tuple[str, ...]) -> _Many:
        match slot.type:
            case Scalar.BOOL:
                return _bools
            case Scalar() as scalar:
                return self._numbers(scalar.size)
            case Clock():
                return self._clocks(slot.type, layout, path)
            case String():
                return self._texts(slot.type, layout, slot.element_size)
            case Ref(name):
                inner, size = self.of(self._layouts[name], 0, _NOWHERE), slot.element_size

                def messages(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
                    for start in range(at, at + number * size, size):
                        for step in inner:
                            step(data, start, out)

                return messages
            case _:
                assert_never(slot.type)

    def _numbers(self, size: int) -> _Many:
        pads = self._dialect.pads(size)

        def numbers(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
            if number:
                out += pads[len(out) % size] + data[at : at + number * size]

        return numbers

    def _clocks(self, clock: Clock, layout: Layout, path: tuple[str, ...]) -> _Many:
        units, code = UNITS[layout.options.time]
        convert, kept, sent = getattr(values, f"{clock.value}_from_{units}"), struct.Struct(code), self._dialect.clocks
        pack, pads = sent[clock].pack, self._pads4
        now = self._stamp.now if self._stamp and self._stamp.path == path else None

        def clocks(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
            if number:
                out += pads[len(out) % 4]
            for start in range(at, at + number * kept.size, kept.size):
                parts = kept.unpack_from(data, start)
                out += pack(*(convert(*parts) if now is None or any(parts) else now()))

        return clocks

    def _texts(self, string: String, layout: Layout, size: int) -> _Many:
        pads, end = self._pads4, self._dialect.end
        name = "from_wide" if string.wide else {"utf-8": "from_text", "latin-1": "from_latin1"}[layout.options.encoding]
        decode = getattr(values, name)

        def texts(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
            for start in range(at, at + number * size, size):
                text = decode(data[start : start + size])
                if string.wide:  # four bytes a unit, as rosidl's code for Fast DDS has them
                    units = text.encode("utf-16-le")
                    kept = b"".join(units[i : i + 2] + b"\0\0" for i in range(0, len(units), 2))
                    out += pads[len(out) % 4] + _U32.pack(len(kept) // 4) + kept
                else:
                    kept = text.encode() + end
                    out += pads[len(out) % 4] + _U32.pack(len(kept)) + kept

        return texts


def _follows(former: Step, step: Step) -> bool:
    return (
        isinstance(former, _Copy)
        and isinstance(step, _Copy)
        and (former.align, former.offset + former.size) == (step.align, step.offset)
    )


def _bools(data: bytes | bytearray, at: int, out: bytearray, number: int) -> None:
    out += bytes(map(bool, data[at : at + number]))
