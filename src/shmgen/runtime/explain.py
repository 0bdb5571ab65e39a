"""Turns a failed `pack_into` into an error that names the field at fault."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from operator import index
from typing import Any, NoReturn

from shmgen.runtime.arrays import numbers
from shmgen.runtime.errors import OutOfRange, ValueRejected

ENCODE_ERRORS = (AttributeError, OverflowError, TypeError, struct.error)
"""What pack_into and the look-ups before it raise for a message that does not fit."""

_BITS = {"b": 8, "h": 16, "i": 32, "q": 64}
_MISSING = object()
_NAMES = {"f": "float32", "d": "float64"}


def explain(message: Any, rows: Iterable[tuple[str, str]], error: Exception) -> NoReturn:
    """Raises OutOfRange for the first field of `rows` that `message` lacks or whose value does not fit.

    `rows` are (path, typecode): `("position.x", "d")`; a number before the code is an array of exactly so
    many, `("covariance", "36d")`; any other code only asks that the field is there. `error` is what
    pack_into raised, told when no field can be blamed.
    """
    if isinstance(error, ValueRejected):
        raise error
    for path, typecode in rows:
        value = _follow(message, path)
        length, code = typecode[:-1], typecode[-1:]
        if length.isdigit() and code in "?bBhHiIqQfd":
            numbers(value, code, struct.calcsize("<" + code), path, exactly=int(length))
        elif code.lower() in _BITS:
            _check_integer(value, code, path)
        elif code in _NAMES:
            _check_float(value, code, path)
    path = getattr(error, "name", None) or ""
    raise OutOfRange(path, f"cannot encode {type(message).__name__}: {error}") from error


def _follow(message: Any, path: str) -> Any:
    value = message
    for name in path.split("."):
        # A field named like a Python keyword is an attribute with an underscore behind.
        inner = getattr(value, name, getattr(value, name + "_", _MISSING))
        if inner is _MISSING:
            raise OutOfRange(path, f"{type(value).__name__} has no attribute {name!r}")
        value = inner
    return value


def _check_integer(value: Any, code: str, path: str) -> None:
    bits = _BITS[code.lower()]
    least, most = (-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)
    name = f"{'' if code.islower() else 'u'}int{bits}"
    try:
        whole = index(value)
    except TypeError:
        raise OutOfRange(path, f"{value!r:.40} is {type(value).__name__}, not {name}") from None
    if not least <= whole <= most:
        raise OutOfRange(path, f"{whole}; {name} goes from {least} to {most}")


def _check_float(value: Any, code: str, path: str) -> None:
    try:
        struct.pack("<" + code, value)
    except (OverflowError, struct.error):
        fault = "too large for" if isinstance(value, (int, float)) else f"{type(value).__name__}, not"
        raise OutOfRange(path, f"{value!r:.40} is {fault} {_NAMES[code]}") from None
