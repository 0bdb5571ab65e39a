"""Convert times and durations of ROS 1 and ROS 2 to TIME, LTIME, or seconds and nanoseconds, and back."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from operator import index
from typing import Any, NamedTuple

from shmgen.runtime.errors import OutOfRange

_SECOND = 1_000_000_000
_MILLISECOND = 1_000_000
_RANGE = 2**32
"""The range of TIME, a DWORD of milliseconds, which wraps around after 49d17h2m47s296ms."""


class Time(NamedTuple):
    """An instant: seconds since 1970 and nanoseconds. `secs` and `nsecs`, the names in ROS 1, are aliases.

    ```python
    stamp = Time(sec=1_700_000_000, nanosec=500_000_000)
    print(stamp.sec + stamp.nanosec / 1e9)
    ```
    """

    sec: int = 0
    nanosec: int = 0

    @property
    def secs(self) -> int:
        """The seconds, under their name in ROS 1."""
        return self.sec

    @property
    def nsecs(self) -> int:
        """The nanoseconds, under their name in ROS 1."""
        return self.nanosec


class Duration(NamedTuple):
    """A duration: seconds, which may be negative, and nanoseconds, which are always added.

    ```python
    before = Duration(sec=-1, nanosec=500_000_000)
    print(before.sec + before.nanosec / 1e9)  # -0.5 s
    ```
    """

    sec: int = 0
    nanosec: int = 0

    @property
    def secs(self) -> int:
        """The seconds, under their name in ROS 1."""
        return self.sec

    @property
    def nsecs(self) -> int:
        """The nanoseconds, under their name in ROS 1."""
        return self.nanosec


class ClockKind(NamedTuple):
    """The storage format of a time or duration: a format of `struct`, and functions that convert the stored integers.

    `packed` is the format. `encode` takes seconds, nanoseconds, and the path of the field for errors, and returns the
    integers. `decode` takes the integers.
    """

    packed: struct.Struct
    encode: Callable[[int, int, str], tuple[int, ...]]
    decode: Callable[..., Time | Duration]


def encode_clock(kind: str, value: Any, path: str) -> bytes:
    """Return the bytes of a time or duration of ROS 1 or ROS 2. Raises OutOfRange if the value does not fit."""
    clock = CLOCKS[kind]
    return clock.packed.pack(*clock.encode(*parts(value, path), path))


def decode_clock(kind: str, data: bytes | bytearray | memoryview) -> Time | Duration:
    """Return the time or duration that the bytes `data` contain."""
    clock = CLOCKS[kind]
    return clock.decode(*clock.packed.unpack(data))


def set_clock(target: Any, clock: Time | Duration) -> Any:
    """Set `target`, a time object of ROS, to the time `clock`, and return `target`.

    If the object is an immutable Time or Duration of shmgen, return `clock` instead.
    """
    if isinstance(target, (Time, Duration)):
        return clock
    if hasattr(target, "sec"):
        target.sec, target.nanosec = clock
    else:
        target.secs, target.nsecs = clock
    return target


def parts(stamp: Any, path: str) -> tuple[int, int]:
    """Return the seconds and nanoseconds of a time or duration. Raises OutOfRange for any other object."""
    try:
        return index(stamp.sec), index(stamp.nanosec)
    except (AttributeError, TypeError):
        pass
    try:
        return index(stamp.secs), index(stamp.nsecs)
    except (AttributeError, TypeError):
        expected = "whole `sec` and `nanosec`, or `secs` and `nsecs`"
        raise OutOfRange(path, f"{stamp!r:.60} is {type(stamp).__name__} without {expected}") from None


def _time_to_ms(seconds: int, nanos: int, path: str) -> tuple[int]:
    """Return a TIME: whole milliseconds modulo 2**32.

    (0, 0) means "unset" in ROS and gives 0. Any other time that would give 0 gives 1: a millisecond late, but set.
    """
    total = seconds * _SECOND + nanos
    return (total // _MILLISECOND % _RANGE or int(total != 0),)


def _duration_to_ms(seconds: int, nanos: int, path: str) -> tuple[int]:
    total = seconds * _SECOND + nanos
    if not 0 <= total < _RANGE * _MILLISECOND:
        raise OutOfRange(path, f"{total / 1e9} s; TIME goes from 0 to 4294967.295 s (use LTIME or struct)")
    return (total // _MILLISECOND,)


def _to_ns(seconds: int, nanos: int, path: str) -> tuple[int]:
    """Return a time as an LTIME: the nanoseconds since 1970 as an unsigned number, which suffices until 2554."""
    total = seconds * _SECOND + nanos
    if not 0 <= total < 2**64:
        raise OutOfRange(path, f"{total / 1e9} s; LTIME goes from 0 to 18446744073.709551615 s")
    return (total,)


def _to_struct(seconds: int, nanos: int, path: str) -> tuple[int, int]:
    if not -(2**31) <= seconds < 2**31:
        raise OutOfRange(path, f"{seconds} s; DINT goes from -2147483648 to 2147483647")
    if not 0 <= nanos < 2**32:
        raise OutOfRange(path, f"{nanos} ns; UDINT goes from 0 to 4294967295")
    return seconds, nanos


def _time_from_ms(value: int) -> Time:
    """Return the time that a TIME represents, or an unset Time for 0.

    A TIME repeats every 2**32 ms (49.7 days). The result is the possible time nearest to this machine's clock. The
    result is correct if the clocks differ by less than 24 days.
    """
    if value == 0:
        return Time()
    now = time.time_ns() // _MILLISECOND
    instant = now + (value - now + _RANGE // 2) % _RANGE - _RANGE // 2
    return Time(instant // 1000, instant % 1000 * _MILLISECOND)


_UDINT, _ULINT, _PARTS = struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<iI")
CLOCKS = {
    "time ms": ClockKind(_UDINT, _time_to_ms, _time_from_ms),
    "time ns": ClockKind(_ULINT, _to_ns, lambda value: Time(*divmod(value, _SECOND))),
    "time s+ns": ClockKind(_PARTS, _to_struct, Time),
    "duration ms": ClockKind(
        _UDINT, _duration_to_ms, lambda value: Duration(value // 1000, value % 1000 * _MILLISECOND)
    ),
    "duration ns": ClockKind(_ULINT, _to_ns, lambda value: Duration(*divmod(value, _SECOND))),
    "duration s+ns": ClockKind(_PARTS, _to_struct, Duration),
}
"""The storage formats of times in the table of fields of a generated class."""
