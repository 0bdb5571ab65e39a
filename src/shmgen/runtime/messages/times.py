"""ROS times and durations, of ROS 1 or ROS 2, as the PLC's TIME, LTIME or seconds."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterable
from copy import copy
from operator import index
from typing import Any, NamedTuple

from shmgen.runtime.errors import OutOfRange
from shmgen.runtime.messages.arrays import check_count

_SECOND = 1_000_000_000
_MILLISECOND = 1_000_000
_RANGE = 2**32
"""TIME is a DWORD of milliseconds: it comes round after 49d17h2m47s296ms."""


class Time(NamedTuple):
    """An instant: seconds since 1970 and nanoseconds; under ROS 1's names too."""

    sec: int = 0
    nanosec: int = 0

    @property
    def secs(self) -> int:
        """ROS 1's name of `sec`."""
        return self.sec

    @property
    def nsecs(self) -> int:
        """ROS 1's name of `nanosec`."""
        return self.nanosec


class Duration(NamedTuple):
    """A length of time: seconds, negative ones too, and nanoseconds, which always count forward."""

    sec: int = 0
    nanosec: int = 0

    @property
    def secs(self) -> int:
        """ROS 1's name of `sec`."""
        return self.sec

    @property
    def nsecs(self) -> int:
        """ROS 1's name of `nanosec`."""
        return self.nanosec


def milliseconds(stamp: Any, path: str) -> int:
    """A time as TIME: modulo 2**32 ms, digits below a millisecond dropped.

    (0, 0), ROS's "unset", gives 0; any other time that comes out as 0 gives 1, a millisecond late instead
    of unset.
    """
    total = _nanoseconds(stamp, path)
    return total // _MILLISECOND % _RANGE or int(total != 0)


def duration_milliseconds(value: Any, path: str) -> int:
    """A duration as TIME, digits below a millisecond dropped. Raises OutOfRange below 0 or above 2**32 - 1 ms."""
    total = _nanoseconds(value, path)
    if not 0 <= total < _RANGE * _MILLISECOND:
        raise OutOfRange(path, f"{total / 1e9} s; TIME goes from 0 to 4294967.295 s (use LTIME or struct)")
    return total // _MILLISECOND


def nanoseconds(stamp: Any, path: str) -> int:
    """A time as LTIME, exact from 1970 to 2554. Raises OutOfRange."""
    total = _nanoseconds(stamp, path)
    if not 0 <= total < 2**64:
        raise OutOfRange(path, f"{total / 1e9} s; LTIME goes from 0 to 18446744073.709551615 s")
    return total


duration_nanoseconds = nanoseconds
"""A duration as LTIME, which knows no sign. Raises OutOfRange."""


def seconds_nanoseconds(stamp: Any, path: str) -> tuple[int, int]:
    """A time or a duration as DINT seconds and UDINT nanoseconds, exact. Raises OutOfRange."""
    seconds, nanos = _parts(stamp, path)
    if not -(2**31) <= seconds < 2**31:
        raise OutOfRange(path, f"{seconds} s; DINT goes from -2147483648 to 2147483647")
    if not 0 <= nanos < 2**32:
        raise OutOfRange(path, f"{nanos} ns; UDINT goes from 0 to 4294967295")
    return seconds, nanos


def time_from_milliseconds(value: int) -> Time:
    """The instant nearest this machine's clock with that TIME: right within 24 days either way; 0 is unset."""
    if value == 0:
        return Time()
    now = time.time_ns() // _MILLISECOND
    instant = now + (value - now + _RANGE // 2) % _RANGE - _RANGE // 2
    return Time(instant // 1000, instant % 1000 * _MILLISECOND)


def duration_from_milliseconds(value: int) -> Duration:
    """The duration of a TIME."""
    return Duration(value // 1000, value % 1000 * _MILLISECOND)


def time_from_nanoseconds(value: int) -> Time:
    """The instant of an LTIME."""
    return Time(*divmod(value, _SECOND))


def duration_from_nanoseconds(value: int) -> Duration:
    """The duration of an LTIME."""
    return Duration(*divmod(value, _SECOND))


time_from_seconds_nanoseconds = Time
duration_from_seconds_nanoseconds = Duration


def set_clock(target: Any, clock: Time | Duration) -> Any:
    """A foreign stamp set in place: `sec` and `nanosec` (ROS 2) or `secs` and `nsecs` (ROS 1). Our own is replaced."""
    if isinstance(target, (Time, Duration)):
        return clock
    if hasattr(target, "sec"):
        target.sec, target.nanosec = clock
    else:
        target.secs, target.nsecs = clock
    return target


def clock_size(code: str) -> int:
    """Bytes of one time or duration: 4 for `I` (TIME), 8 for `Q` (LTIME) and `iI` (struct)."""
    return struct.calcsize("<" + code)


def clocks(
    values: Iterable[Any],
    code: str,
    encode: Callable[[Any, str], int | tuple[int, int]],
    path: str,
    *,
    exactly: int | None = None,
    at_most: int | None = None,
) -> bytes:
    """An array of times or durations; `code` as in clock_size().

    `encode` is one of the functions above. Raises CountExceeded and what `encode` raises.
    """
    check_count(values, path, exactly, at_most)
    pack = struct.Struct("<" + code).pack
    rows = (encode(value, f"{path}[{position}]") for position, value in enumerate(values))
    return b"".join(pack(*row) if isinstance(row, tuple) else pack(row) for row in rows)


def from_clocks(
    data: bytes | bytearray, code: str, decode: Callable[..., Time | Duration], like: Any = ()
) -> list[Any]:
    """The times in `data`, of the kind the list `like` holds; `decode` is one of the `..._from_...`."""
    ours = [decode(*row) for row in struct.iter_unpack("<" + code, data)]
    kind = type(like[0]) if len(like) else Time
    if kind in (Time, Duration):
        return ours
    theirs = [copy(like[0]) for _ in ours]  # rosbags makes none without its values
    for target, stamp in zip(theirs, ours, strict=True):
        set_clock(target, stamp)
    return theirs


def _nanoseconds(stamp: Any, path: str) -> int:
    seconds, nanos = _parts(stamp, path)
    return seconds * _SECOND + nanos


def _parts(stamp: Any, path: str) -> tuple[int, int]:
    try:
        return index(stamp.sec), index(stamp.nanosec)
    except (AttributeError, TypeError):
        pass
    try:
        return index(stamp.secs), index(stamp.nsecs)
    except (AttributeError, TypeError):
        wanted = "whole `sec` and `nanosec`, or `secs` and `nsecs`"
        raise OutOfRange(path, f"{stamp!r:.60} is {type(stamp).__name__} without {wanted}") from None
