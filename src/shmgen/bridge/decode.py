"""Turns the bytes that ROS sends of a message straight into those of its region: what `encode` does, the other way.

What is out of the ordinary is left to the long way, by a message, which says what is wrong with it: bytes that are no
such message, what does not fit, texts that are not plain ASCII.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from shmgen.bridge.dialect import CDR, Dialect
from shmgen.bridge.encode import UNITS
from shmgen.model import Clock, Layout, Layouts, Ref, Role, Scalar, Slot, String, assert_never
from shmgen.runtime import Time, ValueRejected, values

Step = Callable[[bytes, int, bytearray], int]
"""Takes ROS's bytes, how many of them are read, and what there is of the payload, to go on with; gives how many are
read then. Raises _Odd, struct.error, ValueRejected."""

_U32 = struct.Struct("<I")
_BOOLS = b"\0\1"


class _Odd(Exception):
    """To be left to the long way."""


def decoder(layout: Layout, layouts: Layouts, dialect: Dialect = CDR) -> Callable[[bytes], bytearray | None]:
    """What makes payloads of that layout, or None of what is out of the ordinary, as is every `wstring`."""
    steps = _Steps(layouts, dialect).of(layout)
    kind, begin, size, rest = dialect.head[:2], len(dialect.head), layout.size, dialect.rest

    def decode(data: bytes) -> bytearray | None:
        at, out = begin, bytearray()
        if data[: len(kind)] != kind:
            return None
        try:
            for step in steps:
                at = step(data, at, out)
        except (_Odd, struct.error, ValueRejected):
            return None
        return out if 0 <= len(data) - at <= rest and len(out) == size else None

    return decode


class _Copy:
    """Numbers of one size, one behind the other, with `skips` bytes before them."""

    __slots__ = ("align", "size", "skips")

    def __init__(self, size: int, skips: list[int]) -> None:
        self.size, self.align, self.skips = size, len(skips), skips

    def __call__(self, data: bytes, at: int, out: bytearray) -> int:
        at += self.skips[at % self.align]
        end = at + self.size
        out += data[at:end]
        return end


_Many = Callable[[bytes, int, bytearray, int], int]
"""Takes also how many elements there are."""


class _Steps:
    """What takes layouts apart."""

    def __init__(self, layouts: Layouts, dialect: Dialect) -> None:
        self._layouts, self._dialect = layouts, dialect
        self._skips4 = self._skips(4)

    def of(self, layout: Layout) -> list[Step]:
        """Of a message, its padding included."""
        steps: list[Step] = []
        gap: int | None = None  # behind a count, before what it counts
        for slot in layout.slots:
            match slot.role:
                case Role.COUNT:
                    gap = 0
                case Role.PADDING if gap is not None:
                    gap = slot.size
                case Role.PADDING:
                    steps.append(_zeros(slot.size))
                case Role.FILLER:
                    steps.append(self._filler)
                case Role.DATA:
                    found, gap = self._field(slot, layout, gap), None
                    if steps and found and _follows(steps[-1], found[0]):
                        steps[-1] = _joined(steps[-1], found.pop(0))
                    steps += found
                case _:
                    assert_never(slot.role)
        return steps

    def _skips(self, align: int) -> list[int]:
        """Bytes to pass over before a number, by the bytes before it modulo `align`, those of the head included."""
        begin = len(self._dialect.head)
        return [(begin - at) % align if self._dialect.aligned else 0 for at in range(align)]

    def _filler(self, data: bytes, at: int, out: bytearray) -> int:
        out += b"\0"
        return at + len(self._dialect.filler)

    def _field(self, slot: Slot, layout: Layout, gap: int | None) -> list[Step]:
        if gap is None and slot.count is None and isinstance(slot.type, Ref):
            return self.of(self._layouts[slot.type.name])
        read, most = self._elements(slot, layout), 1 if slot.count is None else slot.count
        if gap is None:
            if isinstance(slot.type, Scalar) and slot.type is not Scalar.BOOL:
                return [_Copy(slot.size, self._skips(slot.type.size))]
            return [lambda data, at, out: read(data, at, out, most)]
        skips, zeros = self._skips4, bytes(gap)

        def counted(data: bytes, at: int, out: bytearray) -> int:
            at += skips[at % 4]
            (number,) = _U32.unpack_from(data, at)
            if number > most:
                raise _Odd
            out += data[at : at + 4] + zeros
            end = len(out) + slot.size
            at = read(data, at + 4, out, number)
            out += bytes(end - len(out))
            return at

        return [counted]

    def _elements(self, slot: Slot, layout: Layout) -> _Many:
        match slot.type:
            case Scalar.BOOL:
                return _bools
            case Scalar() as scalar:
                return self._numbers(scalar.size)
            case Clock():
                return self._clocks(slot.type, layout)
            case String():
                return _odd if slot.type.wide else self._texts(slot.element_size)
            case Ref(name):
                inner = self.of(self._layouts[name])

                def messages(data: bytes, at: int, out: bytearray, number: int) -> int:
                    for _ in range(number):
                        for step in inner:
                            at = step(data, at, out)
                    return at

                return messages
            case _:
                assert_never(slot.type)

    def _numbers(self, size: int) -> _Many:
        skips = self._skips(size)

        def numbers(data: bytes, at: int, out: bytearray, number: int) -> int:
            if number:
                at += skips[at % size]
                out += data[at : at + number * size]
            return at + number * size

        return numbers

    def _clocks(self, clock: Clock, layout: Layout) -> _Many:
        units, code = UNITS[layout.options.time]
        prefix = "duration_" if clock is Clock.DURATION and layout.options.time != "struct" else ""
        convert, kept, sent = getattr(values, prefix + units), struct.Struct(code), self._dialect.clocks[clock]
        pack, unpack, skips = kept.pack, sent.unpack_from, self._skips4

        def clocks(data: bytes, at: int, out: bytearray, number: int) -> int:
            if number:
                at += skips[at % 4]
            for _ in range(number):
                made = convert(Time(*unpack(data, at)), "")
                out += pack(*made) if isinstance(made, tuple) else pack(made)
                at += 8
            return at

        return clocks

    def _texts(self, room: int) -> _Many:
        skips, end = self._skips4, self._dialect.end

        def texts(data: bytes, at: int, out: bytearray, number: int) -> int:
            for _ in range(number):
                at += skips[at % 4]
                (length,) = _U32.unpack_from(data, at)
                text = data[at + 4 : at + 4 + length]
                if end:
                    if text[-1:] != end:
                        raise _Odd
                    text = text[:-1]
                if len(text) >= room or b"\0" in text or not text.isascii():
                    raise _Odd
                out += text.ljust(room, b"\0")
                at += 4 + length
            return at

        return texts


def _zeros(size: int) -> Step:
    zeros = bytes(size)

    def pad(data: bytes, at: int, out: bytearray) -> int:
        out += zeros
        return at

    return pad


def _follows(former: Step, step: Step) -> bool:
    return isinstance(former, _Copy) and isinstance(step, _Copy) and former.align == step.align


def _joined(former: Step, step: Step) -> Step:
    assert isinstance(former, _Copy)
    assert isinstance(step, _Copy)
    return _Copy(former.size + step.size, former.skips)


def _odd(data: bytes, at: int, out: bytearray, number: int) -> int:
    raise _Odd


def _bools(data: bytes, at: int, out: bytearray, number: int) -> int:
    found = data[at : at + number]
    if found.translate(None, _BOOLS):
        raise _Odd
    out += found
    return at + number
