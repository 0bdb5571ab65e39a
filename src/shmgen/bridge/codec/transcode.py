"""Moves the bytes of a sample straight into those that ROS sends of it, and back.

The same as decoding a message and encoding it with `bridge.cdr`, or genpy, which the tests hold it to. The extension
in C (transcode.c) does the ordinary at a tenth of the time, and leaves the rest to the Python here.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from shmgen.bridge.codec.steps import CODES, KINDS, UNITS, Step, steps_of
from shmgen.bridge.codec.wire_format import CDR, WireFormat
from shmgen.core.model import Clock, Layout, Layouts
from shmgen.runtime import CountExceeded, Time, ValueRejected, values
from shmgen.runtime.engine import IN_C

if TYPE_CHECKING:
    EXTENSION: Any
else:
    try:
        from shmgen import _transcode
    except ImportError:
        _transcode = None
    EXTENSION = _transcode if IN_C else None

_U32 = struct.Struct("<I")
_KEPT = [struct.Struct({"TIME": "<I", "LTIME": "<Q", "struct": "<iI"}[units]) for _, units in KINDS]
_OUT = [getattr(values, f"{clock.value}_from_{UNITS[units]}") for clock, units in KINDS]
_IN = [
    getattr(values, ("duration_" if clock is Clock.DURATION and units != "struct" else "") + UNITS[units])
    for clock, units in KINDS
]
_BOOLS = b"\0\1"


class Transcoder:
    """For payloads of one layout, and one kind of ROS."""

    def __init__(
        self, layout: Layout, layouts: Layouts, wire_format: WireFormat = CDR, stamp: tuple[str, ...] = ()
    ) -> None:
        """`stamp` are the names of the fields that lead to the time that encode()'s `now` is for."""
        self._wire_format, self._size = wire_format, layout.size
        self._steps = steps_of(layout, layouts, stamp)
        self._pads = {size: wire_format.pads(size) for size in (1, 2, 4, 8)}
        if EXTENSION:
            steps = [(CODES.index(step.code), *step[1:]) for step in self._steps]
            made = EXTENSION.Transcoder(steps, layout.size, not wire_format.aligned)
            self._encode_ordinary, self._decode_ordinary = made.encode, made.decode
        else:
            self._encode_ordinary = self._decode_ordinary = lambda *_: None

    def encode(self, payload: bytes | bytearray, now: Callable[[], Time] = Time) -> bytes:
        """ROS's bytes. `now` gives the stamp where it is zero.

        Raises CountExceeded, and struct.error for a time that ROS cannot hold.
        """
        return self._encode_ordinary(payload, now) or self._encoded(payload, now)

    def decode(self, data: bytes) -> bytearray | None:
        """The payload, or None of what is out of the ordinary: a message says what is wrong with it.

        Bytes that are no such message, what does not fit, texts that are not plain ASCII, every `wstring`.
        """
        made: bytearray | None = self._decode_ordinary(data)
        return made or self._decoded(data)

    def _encoded(self, payload: bytes | bytearray, now: Callable[[], Time]) -> bytes:
        out = bytearray()
        self._put(0, len(self._steps), 0, payload, out, now)
        return self._wire_format.head + out

    def _decoded(self, data: bytes) -> bytearray | None:
        head, out = self._wire_format.head, bytearray(self._size)
        if not data.startswith(head[:2]):
            return None
        try:
            rest = len(data) - self._take(0, len(self._steps), 0, data, len(head), out)
        except (_Odd, struct.error, ValueRejected):
            return None
        return out if 0 <= rest <= self._wire_format.rest else None

    def _put(
        self, first: int, last: int, base: int, data: bytes | bytearray, out: bytearray, now: Callable[[], Time]
    ) -> None:
        """By some of the steps, of a message that begins at `base` of the payload `data`."""
        pads = self._pads
        while first < last:
            step, first = self._steps[first], first + 1
            number, at = step.most, base + step.at
            if step.count_at >= 0:
                (number,) = _U32.unpack_from(data, base + step.count_at)
                if number > step.most:
                    raise CountExceeded("", f"the writer says {number:,} elements; the bound is {step.most:,}")
                out += pads[4][len(out) % 4] + _U32.pack(number)
            places = range(at, at + number * step.size, step.size)
            if step.code == "numbers" and number:
                out += pads[step.size][len(out) % step.size] + data[at : places.stop]
            elif step.code == "bools":
                out += bytes(map(bool, data[at : places.stop]))
            elif step.code == "filler":
                out += self._wire_format.filler
            elif step.code == "messages":
                for place in places:
                    self._put(first, first + step.inner, place, data, out, now)
                first += step.inner
            elif step.code != "numbers":
                for place in places:
                    out += pads[4][len(out) % 4] + self._element(step, data, place, now)

    def _element(self, step: Step, data: bytes | bytearray, at: int, now: Callable[[], Time]) -> bytes:
        if step.code in ("clocks", "stamp"):
            clock, _ = KINDS[step.kind]
            parts = _KEPT[step.kind].unpack_from(data, at)
            unset = step.code == "stamp" and not any(parts)
            return self._wire_format.clocks[clock].pack(*(now() if unset else _OUT[step.kind](*parts)))
        kept = data[at : at + step.size]
        if step.code == "wide texts":  # four bytes a unit, as rosidl's code for Fast DDS has them
            units = values.from_wide(kept).encode("utf-16-le")
            text = b"".join(units[place : place + 2] + b"\0\0" for place in range(0, len(units), 2))
            return _U32.pack(len(text) // 4) + text
        text = (values.from_latin1 if step.kind else values.from_text)(kept).encode() + self._wire_format.end
        return _U32.pack(len(text)) + text

    def _take(self, first: int, last: int, base: int, data: bytes, at: int, out: bytearray) -> int:
        """By some of the steps, of a message that begins at `base` of the payload `out`; gives what of `data` is read.

        Raises _Odd, struct.error, ValueRejected.
        """
        while first < last:
            step, first = self._steps[first], first + 1
            number = step.most
            if step.count_at >= 0:
                at = self._aligned(at, 4)
                (number,) = _U32.unpack_from(data, at)
                if number > step.most:
                    raise _Odd
                _U32.pack_into(out, base + step.count_at, number)
                at += 4
            place = base + step.at
            places = range(place, place + number * step.size, step.size)
            if step.code in ("numbers", "bools") and number:
                at = self._aligned(at, step.size)
                found = data[at : at + number * step.size]
                if len(found) != number * step.size or (step.code == "bools" and found.translate(None, _BOOLS)):
                    raise _Odd
                out[place : places.stop] = found
                at += len(found)
            elif step.code == "filler":
                at += len(self._wire_format.filler)
            elif step.code == "messages":
                for place in places:
                    at = self._take(first, first + step.inner, place, data, at, out)
                first += step.inner
            elif step.code not in ("numbers", "bools"):
                for place in places:
                    at = self._take_element(step, data, self._aligned(at, 4), out, place)
        return at

    def _take_element(self, step: Step, data: bytes, at: int, out: bytearray, place: int) -> int:
        if step.code in ("clocks", "stamp"):
            clock, _ = KINDS[step.kind]
            made = _IN[step.kind](Time(*self._wire_format.clocks[clock].unpack_from(data, at)), "")
            _KEPT[step.kind].pack_into(out, place, *(made if isinstance(made, tuple) else (made,)))
            return at + 8
        length: int = _U32.unpack_from(data, at)[0]
        end = at + 4 + length
        text = data[at + 4 : end]
        kept = text.removesuffix(self._wire_format.end)
        is_whole = len(text) == length and len(kept) == length - len(self._wire_format.end)
        if step.code == "wide texts" or not is_whole or len(kept) >= step.size or 0 in kept or not kept.isascii():
            raise _Odd
        out[place : place + len(kept)] = kept
        return end

    def _aligned(self, at: int, size: int) -> int:
        return at + len(self._pads[size][(at - len(self._wire_format.head)) % size])


class _Odd(Exception):
    """To be left to the long way."""
