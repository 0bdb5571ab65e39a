"""Finds the field at fault when `pack_into` has failed."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any, NoReturn

from shmgen.runtime.errors import OutOfRange, ValueRejected
from shmgen.runtime.messages.arrays import numbers
from shmgen.runtime.messages.range_checks import check

ENCODE_ERRORS = (AttributeError, OverflowError, TypeError, struct.error)
"""What pack_into and the look-ups before it raise for a message that does not fit."""

_CHECKED = frozenset("bBhHiIqQfd")
_MISSING = object()


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
        elif code in _CHECKED:
            check(value, code, path)
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
