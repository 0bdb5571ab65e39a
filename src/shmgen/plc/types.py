"""Map types of Structured Text to types of ROS, or give the reason if ROS has no equivalent."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import NamedTuple

from shmgen.core.diagnostics import closest
from shmgen.core.model import OTHER_NAMES, Scalar
from shmgen.plc.numbers import NotConvertible


class Field(NamedTuple):
    """A field of a .msg file, converted from a type of the PLC."""

    type: str
    """The ROS type with brackets, such as `float64[3]`."""
    own: str
    """The type in the PLC, if shmgen would generate another PLC type from `type`, else `""`."""
    element: str
    """The name of the PLC data type that the field contains, or `""`."""
    many: int
    """The number of elements in an array, or 0."""
    size: int
    """The size of one element in bytes, or 0 if `element` is set."""
    alignment: int
    """The alignment of one element in bytes, or 0 if `element` is set."""
    says: str
    """The note for the field's comment, such as the unit of the number, or `""`."""
    iec: str = ""
    """The type in the PLC, with the value of each bound: `ARRAY[0..2] OF STRING(80)`. SCALARS omits this type."""


_USUAL = {scalar.iec: (scalar.value, scalar.size) for scalar in Scalar if scalar is not Scalar.BOOL}
_USUAL |= {"BOOL": ("bool", 1), "TIME": ("builtin_interfaces/Duration", 4)}
"""PLC type -> ROS type, and size in bytes, for the types that shmgen itself generates. They need no note."""
_OTHERS = {
    "BYTE": ("uint8", 1, ""),
    "WORD": ("uint16", 2, ""),
    "DWORD": ("uint32", 4, ""),
    "LWORD": ("uint64", 8, ""),
    "TOD": ("uint32", 4, "ms since midnight"),
    "TIME_OF_DAY": ("uint32", 4, "ms since midnight"),
    "DATE": ("uint32", 4, "s since 1970"),
    "DT": ("uint32", 4, "s since 1970"),
    "DATE_AND_TIME": ("uint32", 4, "s since 1970"),
    "LTIME": ("uint64", 8, "ns"),
    "LTOD": ("uint64", 8, "ns since midnight"),
    "LDATE": ("uint64", 8, "ns since 1970"),
    "LDT": ("uint64", 8, "ns since 1970"),
}
"""PLC type -> ROS type, size in bytes, and unit of the number, for all other types."""
SCALARS = {name: Field(type_, "", "", 0, size, size, "") for name, (type_, size) in _USUAL.items()}
SCALARS |= {name: Field(type_, name, "", 0, size, size, unit) for name, (type_, size, unit) in _OTHERS.items()}
"""PLC type -> the field of a .msg file."""

_ARRAY = re.compile(r"ARRAY\s*\[([^\]]+)\]\s*OF\s+(.+)", re.IGNORECASE | re.DOTALL)
_STRING = re.compile(r"(W?STRING)\s*(?:[(\[]([^)\]]+)[)\]])?", re.IGNORECASE)
_SEND = "leave it out, or copy the value that it refers to"
_REFUSED = (
    (re.compile(r"(POINTER|REFERENCE)\s+TO\b|REF_TO\b", re.IGNORECASE), "an address of this machine's memory", _SEND),
    (re.compile(r"ARRAY\s*\[\s*\*", re.IGNORECASE), "an array whose size is known at run time only", _SEND),
    (
        re.compile(r"BIT$", re.IGNORECASE),
        "one bit of a byte",
        "declare the whole byte, or a BOOL with a copy of the bit",
    ),
    (
        re.compile(r"(__XWORD|__UXINT|__XINT|__SYSTEM\b.*|ANY\w*)$", re.IGNORECASE),
        "of a different size on other machines",
        "declare it as a type of one size, such as ULINT",
    ),
)
_DEFAULT_STRING = 80
_DEEPEST = 16
"""The limit of nested arrays."""
LARGEST = 2**31
"""The limit of bytes in a type and of elements in an array, which no practical type reaches."""

Numbers = Callable[[str], int]
Named = Callable[[str], tuple[str, str]]


def field(spelled: str, number: Numbers, named: Named, depth: int = 0) -> Field:
    """Return the field for a type of Structured Text.

    * `spelled`: the type as the user wrote it, such as `ARRAY[1..MAX] OF REAL`.
    * `number`: a function that returns the value of a bound, such as `MAX`. Its exceptions are passed on.
    * `named`: a function that returns the names of a data type in ROS and in the PLC. Its exceptions are passed on.
    * `depth`: the number of arrays around this type.

    Raises NotConvertible if ROS has no equivalent.
    """
    spelled = spelled.strip()
    for pattern, why, hint in _REFUSED:
        if pattern.match(spelled):
            raise NotConvertible(f"{_excerpt(spelled)} has no equivalent in ROS: it is {why}", hint)
    if array := _ARRAY.fullmatch(spelled):
        if depth == _DEEPEST:
            raise NotConvertible(
                f"more than {_DEEPEST} nested arrays", "declare one of them as a type of its own", "SHM304"
            )
        return _array(spelled, array[1], array[2].strip(), number, named, depth)
    if string := _STRING.fullmatch(spelled):
        wide = string[1].upper() == "WSTRING"
        length = number(string[2]) if string[2] else _DEFAULT_STRING
        if not 0 < length < LARGEST:
            raise NotConvertible(
                f"the length of {_excerpt(spelled)} is {'below 1' if length < 1 else 'too large'}",
                "write a length such as 80",
            )
        unit = 2 if wide else 1
        iec = f"{string[1].upper()}({length})"
        return Field(f"{string[1].lower()}<={length}", "", "", 0, unit * (length + 1), unit, "", iec)
    word = _base(spelled)
    if scalar := SCALARS.get(word.upper()):
        return scalar._replace(iec=scalar.own or word)
    type_, own = named(word.partition("(")[0].strip())  # initial values of a function block may follow in brackets
    return Field(type_, own, own, 0, 0, 0, "", own)


def intended(word: str, declared: Iterable[str]) -> str:
    """Return the PLC type that `word` probably means, or `""`: `LREAL` for `float64`, or a similar name."""
    word = word.lower()
    return _OF_ROS.get(OTHER_NAMES.get(word, word), "") or closest(word.upper(), [*SCALARS, *declared], 0.7)


_OF_ROS = {scalar.value: scalar.iec for scalar in Scalar} | {
    "bool": "BOOL",
    "char": "USINT",
    "string": "STRING",
    "wstring": "WSTRING",
}


def fits(value: int, type_: str, size: int) -> bool:
    """Return True if an integer is in the range of an integer type of ROS with `size` bytes."""
    values = 1 << 8 * size
    return 0 <= value < values if type_.startswith("u") else -values // 2 <= value < values // 2


def _array(spelled: str, bounds: str, element: str, number: Numbers, named: Named, depth: int) -> Field:
    dimensions = []
    inner = field(element, number, named, depth + 1)
    many = inner.many or 1
    for part in bounds.split(","):
        lower, dots, upper = part.partition("..")
        if not dots:
            raise NotConvertible(f"{_excerpt(spelled)} has no bounds", "write bounds such as `0..9`", "SHM602")
        first, last = number(lower), number(upper)
        dimensions.append(f"{first}..{last}")
        many *= last - first + 1
        if many < 1:
            raise NotConvertible(f"{_excerpt(spelled)} has no elements", "write the lower bound first", "SHM602")
        if many > LARGEST:
            raise NotConvertible(
                f"{_excerpt(spelled)} has more than {LARGEST:,} elements", "declare a smaller array", "SHM303"
            )
    usual = len(dimensions) == 1 and dimensions[0].startswith("0..") and not inner.own and not inner.many
    iec = f"ARRAY[{', '.join(dimensions)}] OF {inner.iec}"
    base = inner.type.partition("[")[0]
    own = "" if usual else iec
    return Field(f"{base}[{many}]", own, inner.element, many, inner.size, inner.alignment, inner.says, iec)


def _base(spelled: str) -> str:
    """Remove a subrange from a type: `INT (0..9)` -> `INT`."""
    word, bracket, rest = spelled.partition("(")
    return word.strip() if bracket and ".." in rest and rest.endswith(")") else spelled


def _excerpt(spelled: str) -> str:
    return spelled if len(spelled) <= 80 else f"{spelled[:80]}…"
