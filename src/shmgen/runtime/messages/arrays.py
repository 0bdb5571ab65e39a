"""Moves sequences into the bytes of an array, and those bytes back into a sequence of the caller's kind.

The host is little-endian, as every machine is that these regions are made for; native arrays are taken as they are.
"""

from __future__ import annotations

import array
import copy
import struct
import sys
from collections.abc import Callable
from typing import Any

from shmgen.core.plural import counted
from shmgen.runtime.errors import CountExceeded, OutOfRange, ValueRejected
from shmgen.runtime.messages.message import Late, Message
from shmgen.runtime.messages.range_checks import REFUSED, boolean, type_name

_KINDS = {code: kind for kind, codes in {"i": "bhilqn", "u": "BHILQN", "f": "efd", "?": "?"}.items() for code in codes}
_NOTHING = memoryview(b"")


def numbers(
    value: Any,
    typecode: str,
    item_size: int,
    path: str,
    *,
    exactly: int | None = None,
    at_most: int | None = None,
) -> memoryview:
    """The bytes of an array of numbers; their number is the length by `item_size`.

    `typecode` is struct's: one of `? b B h H i I q Q f d`. A buffer of that element type (bytes, array.array,
    ndarray, ctypes array) is taken without a copy, and so must not change until it is published; anything else
    is converted element by element. Raises CountExceeded, and OutOfRange with a path such as `data[17]`.
    """
    data = None
    if not isinstance(value, (list, tuple)):
        data = _buffer(value, typecode, item_size)
    if data is None:
        check_count(value, path, exactly, at_most)
        data = _converted(value, typecode, path)
    if exactly is not None or at_most is not None:
        _judge(data.nbytes // item_size, path, exactly, at_most)
    return data


def from_numbers(data: bytes | bytearray | memoryview, typecode: str, like: Any) -> Any:
    """The numbers in `data` as what the message's attribute now is: bytes, list, tuple, array.array or ndarray.

    Anything else, such as None, gets an array.array, or a list of bool.
    """
    kind = type(like)
    if kind in (bytes, bytearray):
        return kind(data)
    numpy = sys.modules.get("numpy")
    if numpy is not None and isinstance(like, numpy.ndarray):
        made = numpy.frombuffer(bytearray(data), dtype=typecode)
        return made.reshape(like.shape) if made.size == like.size else made
    if kind is list or (typecode == "?" and kind is not tuple):
        return list(_unpacked(data, typecode))
    if kind is tuple:
        return _unpacked(data, typecode)
    if (
        kind is array.array
        and like.itemsize == struct.calcsize(typecode)
        and _KINDS.get(like.typecode) == _KINDS[typecode]
    ):
        typecode = like.typecode
    made = array.array(typecode)
    made.frombytes(data)
    return made


def each(
    values: Any,
    encode: Callable[[Any, Any, int, Late], None],
    into: bytearray | memoryview,
    at: int,
    item_size: int,
    path: str,
    late: Late,
    *,
    exactly: int | None = None,
    at_most: int | None = None,
) -> int:
    """Encodes nested messages one after the other from `at` on and returns their number.

    Raises CountExceeded, and what `encode` raises with the path of the element before it.
    """
    count = check_count(values, path, exactly, at_most)
    position = 0
    try:
        for position, value in zip(range(count), values):  # noqa: B007, B905 a list may grow while it is encoded
            encode(value, into, at, late)
            at += item_size
    except ValueRejected as error:
        raise error.inside(f"{path}[{position}]") from None
    return count


def each_back(
    data: bytes | bytearray,
    at: int,
    item_size: int,
    count: int,
    kind: type[Message],
    like: Any,
) -> list[Any]:
    """`count` nested messages of the structure `kind` from `at` on, as new objects of the type the list `like` holds.

    New ones even where `like` has some: the caller may hold one object in two places.
    """
    if not len(like) or type(like[0]) is kind:
        return [kind.from_buffer_copy(data, at + item_size * index) for index in range(count)]
    made = [new_like(like[0]) for _ in range(count)]
    for index, message in enumerate(made):
        kind._decode(data, at + item_size * index, message)
    return made


def new_like(message: Any) -> Any:
    try:
        return type(message)()
    except TypeError:  # a dataclass without defaults, as rosbags makes them
        return copy.deepcopy(message)


def count(value: int, capacity: int, path: str) -> int:
    """A count read from the region, where a PLC may have written 9 of 8. Raises CountExceeded."""
    if value > capacity:
        raise CountExceeded(path, f"the writer says {counted(value, 'element')}; the bound is {capacity}")
    return value


def check_count(values: Any, path: str, exactly: int | None, at_most: int | None) -> int:
    """The length of `values`. Raises OutOfRange if it has none, CountExceeded if it is not allowed."""
    try:
        length = len(values)
    except TypeError:
        raise OutOfRange(path, f"{values!r:.40} is {type(values).__name__}, not a sequence") from None
    _judge(length, path, exactly, at_most)
    return length


def _judge(length: int, path: str, exactly: int | None, at_most: int | None) -> None:
    if exactly is not None and length != exactly:
        raise CountExceeded(path, f"{counted(length, 'element')}; the array has exactly {exactly}")
    if at_most is not None and length > at_most:
        raise CountExceeded(path, f"{counted(length, 'element')}; the bound is {at_most}")


def _buffer(value: Any, typecode: str, item_size: int) -> memoryview | None:
    """The bytes of a buffer whose elements are of the very type; None for any other value."""
    try:
        view = memoryview(value)
    except (TypeError, ValueError, BufferError):
        return None
    if typecode == "B" and view.format == "B" and view.ndim == 1 and view.c_contiguous:
        return view  # of all the most usual, and at a quarter of the time
    form = view.format.lstrip("@=<")
    same = _KINDS.get(form) == _KINDS[typecode] or (form == "c" and typecode == "B")
    if not same or view.itemsize != item_size or view.ndim == 0:
        return None
    if view.nbytes == 0:
        return _NOTHING
    return view.cast("B") if view.c_contiguous else memoryview(view.tobytes())


def _converted(value: Any, typecode: str, path: str) -> memoryview:
    if getattr(value, "ndim", 1) > 1 and hasattr(value, "ravel"):
        value = value.ravel()
    items = value.tolist() if hasattr(value, "tolist") else list(value)
    if not items:
        return _NOTHING
    try:
        return _packed(items, typecode)
    except REFUSED:
        for position, item in enumerate(items):
            try:
                _packed([item], typecode)
            except REFUSED:
                raise OutOfRange(f"{path}[{position}]", f"{item!r:.40} is not a valid {type_name(typecode)}") from None
        raise


def _unpacked(data: bytes | bytearray | memoryview, typecode: str) -> tuple[Any, ...]:
    return struct.unpack(f"<{len(data) // struct.calcsize('<' + typecode)}{typecode}", data)


def _packed(items: list[Any], typecode: str) -> memoryview:
    if typecode == "?":
        return memoryview(bytes(boolean(item, "") for item in items))
    if typecode == "f":
        # array.array stores what a float32 cannot hold as infinity; struct raises.
        return memoryview(struct.pack(f"<{len(items)}f", *items))
    return memoryview(array.array(typecode, items)).cast("B")
