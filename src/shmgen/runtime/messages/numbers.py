"""Convert numbers and arrays of numbers to bytes and back.

The host is little-endian, like every machine that a region can be used on.
"""

from __future__ import annotations

import array
import struct
import sys
from operator import index
from typing import Any

from shmgen.core.plural import counted
from shmgen.runtime.errors import CountExceeded, OutOfRange
from shmgen.runtime.messages.steps import CODES, STRUCTS

REFUSED = (TypeError, ValueError, OverflowError, struct.error)
"""The errors that struct and array raise for a number that does not fit."""
_FAMILIES = {code: kind for kind, codes in {"i": "bhilqn", "u": "BHILQNc", "f": "efd"}.items() for code in codes}


def encode_number(kind: str, value: Any, into: Any, at: int, path: str) -> None:
    """Write a number of type `kind` to `into` at byte `at`. Raises OutOfRange if the value does not fit."""
    if kind == "bool":
        into[at] = boolean(value, path)
        return
    try:
        STRUCTS[kind].pack_into(into, at, value)
    except REFUSED:
        check(kind, value, path)
        raise


def check(kind: str, value: Any, path: str) -> None:
    """Raise OutOfRange if the number type `kind`, such as `uint8`, cannot represent the value."""
    if kind == "bool":
        boolean(value, path)
    elif kind.startswith("float"):
        try:
            STRUCTS[kind].pack(value)
        except REFUSED:
            fault = "too large for" if isinstance(value, (int, float)) else f"{type(value).__name__}, not"
            raise OutOfRange(path, f"{value!r:.40} is {fault} {kind}") from None
    else:
        try:
            whole = index(value)
        except TypeError:
            raise OutOfRange(path, f"{value!r:.40} is {type(value).__name__}, not {kind}") from None
        bits = 8 * STRUCTS[kind].size
        least, most = (0, 2**bits - 1) if CODES[kind].isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        if not least <= whole <= most:
            raise OutOfRange(path, f"{whole}; {kind} goes from {least} to {most}")


def boolean(value: Any, path: str = "") -> bool:
    """Convert a value to a bool. Accept a bool of Python or numpy, 0 and 1.

    Raises OutOfRange for any other value, such as the string "false".
    """
    if (isinstance(value, int) and value in (0, 1)) or type(value).__name__ in ("bool", "bool_"):
        return bool(value)
    raise OutOfRange(path, f"{value!r:.40} is not a bool")


def encode_numbers(kind: str, value: Any, length: int, fixed: bool, path: str) -> memoryview:
    """Return the bytes of an array whose elements are the numbers in `value`.

    If `value` is a buffer with elements of type `kind` (bytes, array.array, ndarray, ctypes array), use its bytes
    without a copy. Convert any other sequence element by element. Raises CountExceeded as check_length() does, or
    OutOfRange with a path such as `data[17]`.
    """
    size, code = STRUCTS[kind].size, CODES[kind]
    data = None if isinstance(value, (list, tuple)) else _buffer(value, code, size)
    if data is None:
        items = _flat(value, length, fixed, path)
        try:
            return memoryview(_pack(items, code))
        except REFUSED:
            for position, item in enumerate(items):
                encode_item(kind, item, bytearray(size), 0, f"{path}[{position}]")
            raise
    check_length(data.nbytes // size, length, fixed, path)
    return data


def encode_item(kind: str, value: Any, into: Any, at: int, path: str) -> None:
    """Write an array element of type `kind` to `into` at byte `at`. Raises OutOfRange if the value does not fit."""
    try:
        data = _pack([value], CODES[kind])
    except REFUSED:
        raise OutOfRange(path, f"{value!r:.40} is not a valid {kind}") from None
    into[at : at + len(data)] = data


def decode_numbers(data: Any, kind: str, like: Any) -> Any:
    """Return the numbers in the bytes `data`, in the same kind of sequence as `like`.

    If `like` is bytes, a list, a tuple, an array.array or an ndarray, the result has the same type. If `like` is
    anything else, such as None, return an array.array, or a list for bool.
    """
    code, sequence_type = CODES[kind], type(like)
    if sequence_type in (bytes, bytearray):
        return sequence_type(data)
    numpy = sys.modules.get("numpy")
    if numpy is not None and isinstance(like, numpy.ndarray):
        numbers = numpy.frombuffer(bytearray(data), dtype=code)
        return numbers.reshape(like.shape) if numbers.size == like.size else numbers
    if sequence_type in (list, tuple) or code == "?":
        items = struct.unpack(f"<{len(data) // STRUCTS[kind].size}{code}", data)
        return items if sequence_type is tuple else list(items)
    if (
        sequence_type is array.array
        and like.itemsize == STRUCTS[kind].size
        and _FAMILIES.get(like.typecode) == _FAMILIES[code]
    ):
        code = like.typecode
    numbers = array.array(code)
    numbers.frombytes(data)
    return numbers


def elements(value: Any, length: int, fixed: bool, path: str) -> list[Any]:
    """Return the elements of the sequence `value` as a list. `path` names the field in errors.

    Raises OutOfRange if `value` is no sequence, and CountExceeded as check_length() does.
    """
    try:
        count = len(value)
        check_length(count, length, fixed, path)
        items = list(value)
    except TypeError:
        raise OutOfRange(path, f"{value!r:.40} is {type(value).__name__}, not a sequence") from None
    if count != len(items):  # len() and iteration disagree
        raise OutOfRange(path, f"len() returns {counted(count, 'element')}, but an iteration yields {len(items)}")
    return items


def check_length(count: int, length: int, fixed: bool, path: str) -> None:
    """Raise CountExceeded if `count` elements exceed the bound `length`.

    If `fixed` is True, `length` is exact: fewer elements raise CountExceeded as well.
    """
    if fixed and count != length:
        raise CountExceeded(path, f"{counted(count, 'element')}; the array has exactly {length}")
    if count > length:
        raise CountExceeded(path, f"{counted(count, 'element')}; the bound is {length}")


def check_count(count: int, length: int, path: str) -> None:
    """Raise CountExceeded if `count`, which a peer wrote into a region, is above the bound `length`.

    A PLC can write any count.
    """
    if count > length:
        raise CountExceeded(path, f"the region has {counted(count, 'element')}; the bound is {length}")


def _buffer(value: Any, code: str, size: int) -> memoryview | None:
    """Return the bytes of `value` if it is a buffer with elements of type `code`, or None for any other value."""
    try:
        view = memoryview(value)
    except (TypeError, ValueError, BufferError):
        return None
    form = view.format.lstrip("@=<")
    same = form == code or (form in _FAMILIES and _FAMILIES[form] == _FAMILIES.get(code))
    if not same or view.itemsize != size or view.ndim == 0:
        return None
    if not view.nbytes:
        return memoryview(b"")
    return view.cast("B") if view.c_contiguous else memoryview(view.tobytes())


def _flat(value: Any, length: int, fixed: bool, path: str) -> list[Any]:
    """Return the elements of any sequence as a list of Python objects. A matrix is read row by row. See elements()."""
    if getattr(value, "ndim", 1) > 1 and hasattr(value, "ravel"):
        value = value.ravel()
    if not hasattr(value, "tolist") or getattr(value, "ndim", 1) == 0:
        return elements(value, length, fixed, path)
    items: list[Any] = value.tolist()
    check_length(len(items), length, fixed, path)
    return items


def _pack(items: list[Any], code: str) -> bytes:
    if code == "?":
        return bytes(boolean(item) for item in items)
    if code == "f":  # array.array stores a number too large for a float32 as infinity; struct raises
        return struct.pack(f"<{len(items)}f", *items)
    return array.array(code, items).tobytes()
