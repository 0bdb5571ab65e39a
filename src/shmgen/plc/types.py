"""What ROS has for a type as Structured Text spells it, or why it has nothing."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from shmgen.plc.numbers import Nothing

SCALARS = {
    "BOOL": ("bool", 1),
    "SINT": ("int8", 1),
    "USINT": ("uint8", 1),
    "BYTE": ("uint8", 1),
    "INT": ("int16", 2),
    "UINT": ("uint16", 2),
    "WORD": ("uint16", 2),
    "DINT": ("int32", 4),
    "UDINT": ("uint32", 4),
    "DWORD": ("uint32", 4),
    "LINT": ("int64", 8),
    "ULINT": ("uint64", 8),
    "LWORD": ("uint64", 8),
    "REAL": ("float32", 4),
    "LREAL": ("float64", 8),
    "TIME": ("builtin_interfaces/Duration", 4),
    "TOD": ("uint32", 4),
    "TIME_OF_DAY": ("uint32", 4),
    "DATE": ("uint32", 4),
    "DT": ("uint32", 4),
    "DATE_AND_TIME": ("uint32", 4),
    "LTIME": ("uint64", 8),
    "LTOD": ("uint64", 8),
    "LDATE": ("uint64", 8),
    "LDT": ("uint64", 8),
}
"""ROS type and bytes."""
_UNITS = {
    "TOD": "ms since midnight",
    "TIME_OF_DAY": "ms since midnight",
    "DATE": "s since 1970",
    "DT": "s since 1970",
    "DATE_AND_TIME": "s since 1970",
    "LTIME": "ns",
    "LTOD": "ns since midnight",
    "LDATE": "ns since 1970",
    "LDT": "ns since 1970",
}
_PLAIN = {"BOOL", "SINT", "USINT", "INT", "UINT", "DINT", "UDINT", "LINT", "ULINT", "REAL", "LREAL", "TIME"}
"""Those that shmgen writes for their ROS types itself."""


class Field(NamedTuple):
    """What stands in a .msg: the ROS type, its brackets in it. `own` is the spelling to keep, if shmgen's differs.

    `element` is the name of a data type of the project, else empty; `size` and `alignment` are 0 then.
    """

    type: str
    own: str
    element: str
    many: int
    size: int
    alignment: int
    says: str


_ARRAY = re.compile(r"ARRAY\s*\[([^\]]+)\]\s*OF\s+(.+)", re.IGNORECASE | re.DOTALL)
_STRING = re.compile(r"(W?STRING)\s*(?:[(\[]([^)\]]+)[)\]])?", re.IGNORECASE)
_SEND = "leave it out of what you share, or send what it shows"
_REFUSED = (
    (re.compile(r"(POINTER|REFERENCE)\s+TO\b|REF_TO\b", re.IGNORECASE), "an address of this machine's memory", _SEND),
    (re.compile(r"ARRAY\s*\[\s*\*", re.IGNORECASE), "an array whose size is known at run time only", _SEND),
    (
        re.compile(r"BIT$", re.IGNORECASE),
        "one bit of a byte that it shares",
        "share its byte, or a BOOL copied from it",
    ),
    (
        re.compile(r"(__XWORD|__UXINT|__XINT|__SYSTEM\b.*|ANY\w*)$", re.IGNORECASE),
        "of another size on other machines",
        "declare it as a type of one size, such as ULINT",
    ),
)
_DEFAULT_STRING = 80
_DEEPEST = 16
"""Arrays of arrays."""
LARGEST = 2**31
"""Bytes, or elements, that nobody shares."""

Numbers = Callable[[str], int]
Named = Callable[[str], tuple[str, str]]


def field(spelled: str, number: Numbers, named: Named, depth: int = 0) -> Field:
    """`named` gives what a data type of the project is called in ROS and in the PLC; what it raises passes.

    `number` gives what a bound comes to. Raises Nothing.
    """
    spelled = spelled.strip()
    for pattern, why, hint in _REFUSED:
        if pattern.match(spelled):
            raise Nothing(f"ROS has nothing for {_shown(spelled)}: {why}", hint)
    if array := _ARRAY.fullmatch(spelled):
        if depth == _DEEPEST:
            raise Nothing(f"more than {_DEEPEST} arrays in each other", "give one of them a name", "SHM304")
        return _array(spelled, array[1], array[2].strip(), number, named, depth)
    if string := _STRING.fullmatch(spelled):
        wide = string[1].upper() == "WSTRING"
        length = number(string[2]) if string[2] else _DEFAULT_STRING
        if not 0 < length < LARGEST:
            raise Nothing(
                f"{_shown(spelled)} holds {'nothing' if length < 1 else 'too much'}", "write its length as 80"
            )
        unit = 2 if wide else 1
        return Field(f"{string[1].lower()}<={length}", "", "", 0, unit * (length + 1), unit, "")
    word = _base(spelled)
    if word.upper() in SCALARS:
        type_, size = SCALARS[word.upper()]
        own = "" if word.upper() in _PLAIN else word.upper()
        return Field(type_, own, "", 0, size, size, _UNITS.get(word.upper(), ""))
    type_, own = named(word.partition("(")[0].strip())  # a function block may be given values there
    return Field(type_, own, own, 0, 0, 0, "")


def fits(value: int, type_: str, size: int) -> bool:
    """Whether a whole number is one of a ROS type."""
    values = 1 << 8 * size
    return 0 <= value < values if type_.startswith("u") else -values // 2 <= value < values // 2


def _array(spelled: str, bounds: str, element: str, number: Numbers, named: Named, depth: int) -> Field:
    dimensions = []
    inner = field(element, number, named, depth + 1)
    many = inner.many or 1
    for part in bounds.split(","):
        lower, dots, upper = part.partition("..")
        if not dots:
            raise Nothing(f"{_shown(spelled)} has no bounds", "write them as `0..9`", "SHM602")
        first, last = number(lower), number(upper)
        dimensions.append(f"{first}..{last}")
        many *= last - first + 1
        if many < 1:
            raise Nothing(f"{_shown(spelled)} holds nothing", "write the lower bound first", "SHM602")
        if many > LARGEST:
            raise Nothing(f"{_shown(spelled)} has more than {LARGEST:,} elements", "share a part of it", "SHM303")
    usual = len(dimensions) == 1 and dimensions[0].startswith("0..") and not inner.own and not inner.many
    own = "" if usual else f"ARRAY[{', '.join(dimensions)}] OF {inner.own or _iec(inner, element)}"
    base = inner.type.partition("[")[0]
    return Field(f"{base}[{many}]", own, inner.element, many, inner.size, inner.alignment, inner.says)


def _iec(inner: Field, element: str) -> str:
    """How an element is spelled whose type has no `own`."""
    if string := _STRING.fullmatch(element):
        return f"{string[1].upper()}({inner.type.partition('=')[2]})"
    if array := _ARRAY.fullmatch(element):
        return (
            f"ARRAY[0..{inner.many - 1}] OF {_iec(inner._replace(type=inner.type.partition('[')[0]), array[2].strip())}"
        )
    return _base(element)


def _base(spelled: str) -> str:
    """`INT (0..9)` -> `INT`."""
    word, bracket, rest = spelled.partition("(")
    return word.strip() if bracket and ".." in rest and rest.endswith(")") else spelled


def _shown(spelled: str) -> str:
    return spelled if len(spelled) <= 80 else f"{spelled[:80]}…"
