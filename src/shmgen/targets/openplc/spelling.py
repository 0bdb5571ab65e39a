"""Spells types and first values as STruC++ does in C++ and in a library's manifest."""

from __future__ import annotations

import re

from shmgen.targets.openplc.blocks import Variable

_ARRAY = re.compile(r"ARRAY\[0\.\.(\d+)\] OF (.+)")
_TEXT = re.compile(r"STRING\((\d+)\)")
_ELEMENTARY = re.compile("BOOL|BYTE|[DL]?WORD|U?[SDL]?INT|L?REAL|TIME")


def cpp_type(spelled: str) -> str:
    """`ARRAY[0..2] OF LREAL` -> `Array1D<IEC_LREAL, 0, 2>`."""
    if array := _ARRAY.fullmatch(spelled):
        return f"Array1D<{cpp_type(array[2])}, 0, {array[1]}>"
    if text := _TEXT.fullmatch(spelled):
        return f"IECStringVar<{text[1]}>"
    if spelled == "STRING":
        return "IECStringVar<254>"
    return f"IEC_{spelled}" if _ELEMENTARY.fullmatch(spelled) else spelled.upper()


def manifest_type(spelled: str) -> str:
    """`STRING(80)` -> `STRING`, `ARRAY[0..2] OF LREAL` -> `__INLINE_ARRAY_LREAL`."""
    if array := _ARRAY.fullmatch(spelled):
        return f"__INLINE_ARRAY_{manifest_type(array[2])}"
    return spelled.partition("(")[0].upper()


def cpp_value(variable: Variable) -> str:
    """What stands between the braces behind the name."""
    value = variable.value
    if array := _ARRAY.fullmatch(variable.type):
        values = value.strip("[]").split(", ") if value else []
        # Spelled with its type each: a list of literals of two types has none, and C++ takes it for no list then.
        return ", ".join(f"IEC_{array[2]}({_literal(one, array[2])})" for one in values)
    return _literal(value, variable.type) if value else ""


def _literal(value: str, type_: str) -> str:
    if value in ("TRUE", "FALSE"):
        return value.lower()
    if type_ == "TIME":
        return f"INT64_C({value.removeprefix('T#').removesuffix('s')}000000000)"
    if type_ == "REAL":
        return f"{value}f"
    if type_ in ("ULINT", "LWORD"):
        return f"{value}ULL"
    return f"{value}LL" if type_ == "LINT" else value
