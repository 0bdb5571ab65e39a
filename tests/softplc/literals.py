"""Converts literals of Structured Text to C++. Without a type, they become `Integer<5ULL>{}` or `Real{1.5}`."""

from __future__ import annotations

import re
from typing import Any

from blark import transform as b

from tests.softplc.reading import Unsupported


def literal(tree: b.Literal) -> str:
    match tree:
        case b.Integer():
            base = {"HexInteger": 16, "OctalInteger": 8, "BinaryInteger": 2}.get(type(tree).__name__, 10)
            number = int(str(tree.value).replace("_", ""), base)
            return _typed(tree.type_name, f"Integer<{abs(number)}ULL{', true' if number < 0 else ''}>{{}}")
        case b.Real():
            return _typed(tree.type_name, f"Real{{{str(tree.value).replace('_', '')}}}")
        case b.Boolean():
            return f"BOOL({'true' if str(tree.value).upper() in ('TRUE', '1') else 'false'})"
        case b.Duration(negative=False):
            return f"TIME{{{_duration(tree)}u}}"
        case b.String():
            return _text(str(tree.value))
        case _:
            raise Unsupported(f"the literal {type(tree).__name__}")


def _typed(type_: Any, spelled: str) -> str:
    return spelled if type_ is None else f"as<{str(type_).upper()}>({spelled})"


def _duration(tree: b.Duration) -> int:
    """Return a duration in milliseconds. A part of a millisecond is dropped."""
    units = {"days": 86_400_000, "hours": 3_600_000, "minutes": 60_000, "seconds": 1000, "milliseconds": 1}
    ms = sum(float(getattr(tree, unit)) * factor for unit, factor in units.items() if getattr(tree, unit) is not None)
    if ms >= 2**32 or any(getattr(tree, unit, None) for unit in ("microseconds", "nanoseconds")):
        raise Unsupported("a TIME literal outside of 0..T#49d17h2m47s295ms, or below a millisecond")
    return int(ms)


_ESCAPES = {"N": "\n", "L": "\n", "P": "\f", "R": "\r", "T": "\t"}


def _text(spelled: str) -> str:
    """Convert a string literal to C++: `'it$'s'` -> `text("it's")`. Each character becomes a number."""
    wide = spelled.startswith('"')
    digits = 4 if wide else 2
    units = []
    for match in re.finditer(rf"\$([0-9A-Fa-f]{{{digits}}})|\$(.)|(.)", spelled[1:-1], re.DOTALL):
        code, escaped, plain = match.groups()
        units.append(int(code, 16) if code else ord(_ESCAPES.get(escaped.upper(), escaped) if escaped else plain))
    kind = "char16_t" if wide else "char"
    numbers = ", ".join(f"({kind}){unit}" for unit in [*units, 0])
    return f"text<{len(units) + 1}, {kind}>({{{numbers}}})"
