"""The plan by which the extension moves messages of a generated class to its bytes and back (codec.c).

A class that shows a field otherwise than generated code does has none: its `_encode` and `_decode` do it then, as they
do for every message that is out of the ordinary.
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

from shmgen.runtime.messages import strings, times
from shmgen.runtime.messages.arrays import from_numbers, new_like
from shmgen.runtime.messages.fields import Clock, Clocks, Elements, Text, Texts
from shmgen.runtime.messages.range_checks import CODES

NUMBERS = CODES | {ctypes.c_double: "d"}
TEXTS = {
    (strings.text, strings.from_text): ("u", False),
    (strings.text_cut, strings.from_text): ("u", True),
    (strings.text_latin1, strings.from_latin1): ("l", False),
    (strings.text_latin1_cut, strings.from_latin1): ("l", True),
    (strings.wide_text, strings.from_wide): ("w", False),
    (strings.wide_text_cut, strings.from_wide): ("w", True),
}
"""How a text is encoded and decoded: its code in a plan, and whether one that is too long is cut."""
CLOCKS = {
    ("I", times.milliseconds, times.time_from_milliseconds): ("T", times.Time),
    ("I", times.duration_milliseconds, times.duration_from_milliseconds): ("D", times.Duration),
    ("Q", times.nanoseconds, times.time_from_nanoseconds): ("N", times.Time),
    ("Q", times.duration_nanoseconds, times.duration_from_nanoseconds): ("N", times.Duration),
    ("iI", times.seconds_nanoseconds, times.Time): ("P", times.Time),
    ("iI", times.seconds_nanoseconds, times.Duration): ("P", times.Duration),
}
"""How a time is packed, and the functions of a field: its code in a plan, and what is made of it."""
_NAMES = ("sec", "nanosec", "secs", "nsecs", "__copy__", "from_buffer_copy")
_TOOLS = (*_NAMES, copy.copy, new_like, from_numbers, times.Time, times.Duration, SimpleNamespace)
"""What codec.c refers to, in its order."""


class Step(NamedTuple):
    """An attribute: elements of `size` bytes that lie one behind the other, from byte `at` of its message on.

    They are `most` of an array, of which the uint32 at `count_at` says how many are there unless that is -1; 0: no
    array. `code` is struct's, one of TEXTS or CLOCKS, or `M`: a message, whose `inner` steps come next.
    """

    name: str
    code: str
    at: int
    size: int
    most: int = 0
    count_at: int = -1
    inner: int = 0
    cuts: bool = False
    kind: type | None = None


class _OtherwiseShown(Exception):
    """A field of which only Python knows what it is."""


def codec(make: Any, kind: Any) -> Any:
    """A Codec, which is what `make` makes of a plan; None: the class has none."""
    steps = plan(kind)
    return None if steps is None else make(steps, ctypes.sizeof(kind), _TOOLS)


def plan(kind: Any) -> tuple[Step, ...] | None:
    """None: the class is not as it was generated."""
    try:
        return tuple(_steps(kind))
    except _OtherwiseShown:
        return None


def _steps(kind: Any) -> Iterator[Step]:
    types = {name: inner for base in kind.__mro__ for name, inner, *_ in vars(base).get("_fields_", ())}
    for name in kind._names_:
        shown = next((vars(base)[name] for base in kind.__mro__ if name in vars(base)), None)
        match shown:
            case Elements():
                many = shown.length, -1 if shown.count_at is None else shown.count_at
                yield from _numbers(name, shown.kind, shown.offset, *many)
            case Text() | Texts():
                yield _text(name, shown)
            case Clock():
                yield _clock(name, shown.array)._replace(most=0)
            case Clocks():
                yield _clock(name, shown)
            case object(offset=int(offset)) if name in types:
                yield from _numbers(name, types[name], offset)
            case _:
                raise _OtherwiseShown


def _numbers(name: str, kind: Any, at: int, most: int = 0, count_at: int = -1) -> Iterator[Step]:
    """Of numbers one step, of messages theirs too."""
    size = ctypes.sizeof(kind)
    if kind in NUMBERS:
        yield Step(name, NUMBERS[kind], at, size, most, count_at)
    elif issubclass(kind, ctypes.Structure):
        inner = tuple(_steps(kind))
        yield Step(name, "M", at, size, most, count_at, len(inner), kind=kind)
        yield from inner
    else:
        raise _OtherwiseShown


def _text(name: str, field: Text | Texts) -> Step:
    code, cuts = _known(TEXTS, field.encode, field.decode)
    if field.size != (field.capacity + 1) * (2 if code == "w" else 1):
        raise _OtherwiseShown
    step = Step(name, code, field.offset, field.size, cuts=cuts)
    if isinstance(field, Text):
        return step
    return step._replace(most=field.length, count_at=-1 if field.count_at is None else field.count_at)


def _clock(name: str, field: Clocks) -> Step:
    code, made = _known(CLOCKS, field.code, field.convert, field.make)
    count_at = -1 if field.count_at is None else field.count_at
    return Step(name, code, field.offset, field.item_size, field.length, count_at, kind=made)


def _known(ways: Any, *key: Any) -> Any:
    if key not in ways:
        raise _OtherwiseShown
    return ways[key]
