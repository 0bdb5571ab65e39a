"""Turns a type as Structured Text spells it into what ROS has for it, or says why it has nothing."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

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


class Nothing(Exception):
    """ROS has no type for it; `code` is that of the diagnostic."""

    def __init__(self, message: str, hint: str, code: str = "SHM601") -> None:
        super().__init__(message)
        self.message, self.hint, self.code = message, hint, code


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
_STRING = re.compile(r"(W?STRING)\s*(?:[(\[]\s*([^)\]]+?)\s*[)\]])?", re.IGNORECASE)
_SUBRANGE = re.compile(r"([A-Za-z_]\w*)\s*\(.*\.\..*\)", re.DOTALL)
_DYNAMIC = "an array whose size is known at run time only"
_REFUSED = (
    (re.compile(r"(POINTER|REFERENCE)\s+TO\b|REF_TO\b", re.IGNORECASE), "an address of this machine's memory"),
    (re.compile(r"ARRAY\s*\[\s*\*", re.IGNORECASE), _DYNAMIC),
    (re.compile(r"BIT$", re.IGNORECASE), "one bit of a byte that it shares"),
    (re.compile(r"(__XWORD|__UXINT|__XINT|__SYSTEM\b.*|ANY\w*)$", re.IGNORECASE), "of another size on other machines"),
)
_DEFAULT_STRING = 80


def field(spelled: str, constants: Mapping[str, str], named: Callable[[str], str]) -> Field:
    """`named` gives the ROS name of a data type of the project; what it raises passes. Raises Nothing."""
    for pattern, why in _REFUSED:
        if pattern.match(spelled.strip()):
            raise Nothing(
                f"ROS has nothing for {spelled}: {why}", "leave it out of what you share, or send what it shows"
            )
    if array := _ARRAY.fullmatch(spelled.strip()):
        return _array(spelled, array[1], array[2], constants, named)
    if string := _STRING.fullmatch(spelled.strip()):
        wide = string[1].upper() == "WSTRING"
        length = number(string[2], constants) if string[2] else _DEFAULT_STRING
        unit = 2 if wide else 1
        return Field(f"{string[1].lower()}<={length}", "", "", 0, unit * (length + 1), unit, "")
    word = subrange[1] if (subrange := _SUBRANGE.fullmatch(spelled.strip())) else spelled.strip()
    if word.upper() in SCALARS:
        type_, size = SCALARS[word.upper()]
        own = "" if word.upper() in _PLAIN else word.upper()
        return Field(type_, own, "", 0, size, size, _UNITS.get(word.upper(), ""))
    return Field(named(word), word, word, 0, 0, 0, "")


def _array(spelled: str, bounds: str, element: str, constants: Mapping[str, str], named: Callable[[str], str]) -> Field:
    dimensions = []
    for part in bounds.split(","):
        lower, dots, upper = part.partition("..")
        if not dots:
            raise Nothing(f"{spelled} has no bounds", "write them as `0..9`", "SHM602")
        dimensions.append((number(lower, constants), number(upper, constants)))
    inner = field(element, constants, named)
    many = inner.many or 1
    for first, last in dimensions:
        many *= last - first + 1
    if many < 1:
        raise Nothing(f"{spelled} holds nothing", "write the lower bound first", "SHM602")
    spelled_inner = inner.own or _iec(inner, element)
    usual = len(dimensions) == 1 and dimensions[0][0] == 0 and not inner.own and not inner.many
    bounds = ", ".join(f"{lower}..{upper}" for lower, upper in dimensions)
    own = "" if usual else f"ARRAY[{bounds}] OF {spelled_inner}"
    base = inner.type.partition("[")[0]
    return Field(f"{base}[{many}]", own, inner.element, many, inner.size, inner.alignment, inner.says)


def _iec(inner: Field, element: str) -> str:
    if string := _STRING.fullmatch(element.strip()):
        return f"{string[1].upper()}({inner.type.partition('=')[2]})"
    return subrange[1] if (subrange := _SUBRANGE.fullmatch(element.strip())) else element.strip()


_NUMBER = re.compile(r"(?:[A-Za-z_]\w*#)?([-+]?)(?:(\d+)#([0-9A-Fa-f_]+)|([\d_]+))")
_SUM = re.compile(r"(.+?)\s*([-+*])\s*([^-+*]+)", re.DOTALL)


def number(text: str, constants: Mapping[str, str], depth: int = 0) -> int:
    """`10`, `16#FF`, `MAX_AXES`, `GVL.MAX_AXES - 1`. Raises Nothing: SHM602."""
    text = text.strip().strip("()").strip()
    if found := _NUMBER.fullmatch(text):
        digits, base = (found[3], int(found[2])) if found[2] else (found[4], 10)
        try:
            return int(digits.replace("_", ""), base) * (-1 if found[1] == "-" else 1)
        except ValueError:
            pass
    name = text.rpartition(".")[2].upper()
    if name in constants and depth < 8:
        return number(constants[name], constants, depth + 1)
    if depth < 8 and (found := _SUM.fullmatch(text)):
        one, other = number(found[1], constants, depth + 1), number(found[3], constants, depth + 1)
        return {"+": one + other, "-": one - other, "*": one * other}[found[2]]
    raise Nothing(f"`{text}` is not known", "import the list of constants that declares it too", "SHM602")
