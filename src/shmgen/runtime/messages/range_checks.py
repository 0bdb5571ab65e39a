"""Refuses a number that its type cannot hold, where ctypes would store what is left of it.

ctypes keeps the low 32 bits of a number too large for an int32, infinity of 1e300 in a float32, and True for any text.
float64 is not among what is checked: whatever ctypes takes for one fits.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Iterable
from functools import lru_cache
from operator import index
from typing import TYPE_CHECKING, Any

from shmgen.runtime.errors import OutOfRange

CODES = {
    ctypes.c_bool: "?",
    ctypes.c_int8: "b",
    ctypes.c_uint8: "B",
    ctypes.c_int16: "h",
    ctypes.c_uint16: "H",
    ctypes.c_int32: "i",
    ctypes.c_uint32: "I",
    ctypes.c_int64: "q",
    ctypes.c_uint64: "Q",
    ctypes.c_float: "f",
}
"""Of the types that ctypes stores anything in, struct's code, which stores only what fits."""

REFUSED = (TypeError, ValueError, OverflowError, struct.error)
"""What struct and array raise for a number that does not fit."""

_FLOATS = {"f": "float32", "d": "float64"}
_KEPT = 256


class _Checks(type(ctypes.Structure)):  # type: ignore[misc]
    """Has what is assigned to the numbers of a structure checked. Reading stays with ctypes."""

    def __init__(cls, name: str, bases: tuple[type, ...], body: dict[str, Any]) -> None:
        super().__init__(name, bases, body)
        for field, kind, *_ in body.get("_fields_", ()):
            if kind in CODES:
                setattr(cls, field, _number(cls.__dict__[field], CODES[kind], field))


if TYPE_CHECKING:  # stubs of different age disagree on what the type of a structure is
    CheckedStructure = ctypes.LittleEndianStructure
else:

    class CheckedStructure(ctypes.LittleEndianStructure, metaclass=_Checks):
        """A structure whose numbers raise OutOfRange, with the field's name, for what does not fit."""

        __slots__ = ()


@lru_cache(_KEPT)
def array_of(kind: Any, length: int, path: str) -> Any:
    """The type of `length` elements of `kind`, which checks what is assigned to them; `path` is their field's."""
    if kind not in CODES:
        return kind * length
    return type("Numbers", (_Numbers, ctypes.Array), {"_type_": kind, "_length_": length, "_path": path})


def check(value: Any, code: str, path: str) -> None:
    """Raises OutOfRange if `value` is nothing that struct's `code` can hold: one of `? b B h H i I q Q f d`."""
    if code == "?":
        boolean(value, path)
    elif code in _FLOATS:
        _check_float(value, code, path)
    else:
        _check_integer(value, code, path)


def boolean(value: Any, path: str = "") -> bool:
    """True, False, 0, 1 or numpy's bool. Raises OutOfRange, where struct's `?` would take the text "false" as true."""
    if value is True or value is False:
        return bool(value)
    if (isinstance(value, int) and value in (0, 1)) or type(value).__name__ in ("bool", "bool_"):
        return bool(value)
    raise OutOfRange(path, f"{value!r:.40} is not a bool")


def type_name(code: str) -> str:
    """What ROS calls struct's `code`: `uint8`."""
    if code in _FLOATS:
        return _FLOATS[code]
    return "bool" if code == "?" else f"{'' if code.islower() else 'u'}int{8 * struct.calcsize(code)}"


def _number(stored: Any, code: str, path: str) -> property:
    fits, store = boolean if code == "?" else struct.Struct("<" + code).pack, stored.__set__

    def assign(structure: ctypes.Structure, value: Any) -> None:
        try:
            fits(value)  # struct's pack_into would leave a 0 where it raises
        except REFUSED:
            check(value, code, path)
            raise
        store(structure, value)

    return _Number(stored.__get__, assign).at(stored.offset, stored.size)


class _Number(property):
    """As a field of ctypes is, with its offset and size in bytes."""

    offset: int
    size: int

    def at(self, offset: int, size: int) -> _Number:
        self.offset, self.size = offset, size
        return self


class _Numbers:
    """An array of ctypes whose elements are checked, with `data[17]` as the path."""

    _type_: Any
    _path: str

    def __setitem__(self, where: int | slice, value: Any) -> None:
        if isinstance(where, slice):
            value = self._checked(range(len(self))[where], value)  # type: ignore[arg-type]
        else:
            check(value, CODES[self._type_], f"{self._path}[{where}]")
        super().__setitem__(where, value)  # type: ignore[misc]

    def _checked(self, positions: range, value: Iterable[Any]) -> Any:
        code, items = CODES[self._type_], value.tolist() if hasattr(value, "tolist") else list(value)
        try:
            if code == "?":
                raise TypeError  # struct takes anything
            struct.pack(f"<{len(items)}{code}", *items)
        except REFUSED:
            for position, item in zip(positions, items):  # noqa: B905 ctypes compares the lengths
                check(item, code, f"{self._path}[{position}]")
        return items


def _check_integer(value: Any, code: str, path: str) -> None:
    bits = 8 * struct.calcsize(code)
    least, most = (-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)
    try:
        whole = index(value)
    except TypeError:
        raise OutOfRange(path, f"{value!r:.40} is {type(value).__name__}, not {type_name(code)}") from None
    if not least <= whole <= most:
        raise OutOfRange(path, f"{whole}; {type_name(code)} goes from {least} to {most}")


def _check_float(value: Any, code: str, path: str) -> None:
    try:
        struct.pack("<" + code, value)
    except REFUSED:
        fault = "too large for" if isinstance(value, (int, float)) else f"{type(value).__name__}, not"
        raise OutOfRange(path, f"{value!r:.40} is {fault} {type_name(code)}") from None
