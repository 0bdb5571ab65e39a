"""Turns values and comments into Structured Text: literals, and ASCII that cannot leave its comment."""

from __future__ import annotations

import math
import re
import textwrap
import unicodedata
from collections.abc import Iterable, Iterator

from shmgen.model import Scalar, String, TypeOptions, Value, assert_never

MADE = "// Made by shmgen; changes made here are lost."
"""Stands in the head of each file whose first line does not say so."""
WIDTH = 118
_COMMENT_WIDTH = 100


def comment_lines(text: str) -> list[str]:
    """`// ` lines. Lines of the text stay lines, ones longer than 100 characters are folded."""
    return [f"// {line}".rstrip() for given in text.splitlines() for line in _fold(ascii_text(given))]


def uncommented(lines: Iterable[str]) -> tuple[str, ...]:
    """What comment lines say."""
    return tuple(line[2:].strip() for line in lines)


def ascii_text(text: str) -> str:
    """One line of ASCII without `(*` and `*)`.

    A letter loses its accent, a common sign is spelled (`±` is `+/-`), what has no likeness becomes `<U+03B1>`,
    and a control character becomes a blank.
    """
    plain = text if text.isascii() and text.isprintable() else "".join(map(_ascii, text))
    return re.sub(r"\((?=\*)|\*(?=\))", lambda found: found[0] + " ", plain).rstrip()


def literal(value: Value, type_: Scalar | String, options: TypeOptions) -> str | None:
    """None for what has no literal: infinities, and what is not a number.

    Raises UnicodeEncodeError for a string that the configured encoding does not know.
    """
    match type_:
        case Scalar.BOOL if options.bool == "BOOL":
            return "TRUE" if value else "FALSE"
        case Scalar.FLOAT32 | Scalar.FLOAT64:
            return _real(float(value))
        case Scalar.INT64 if value == -(2**63):
            return "-9223372036854775807 - 1"  # a literal has no sign, and 2**63 is no LINT
        case Scalar():
            return str(int(value))
        case String(wide=True):
            return '"' + "".join(_wide_units(str(value))) + '"'
        case String():
            return "'" + "".join(_narrow_bytes(str(value).encode(options.encoding))) + "'"
        case _:
            assert_never(type_)


def _fold(line: str) -> list[str]:
    if len(line) <= _COMMENT_WIDTH:
        return [line]
    return textwrap.wrap(line, _COMMENT_WIDTH, break_long_words=False, break_on_hyphens=False)


def _ascii(char: str) -> str:
    if char.isascii():
        return char if char.isprintable() else " "
    return _SPELLED.get(char) or "".join(_bare(part) for part in unicodedata.normalize("NFKD", char))


def _bare(char: str) -> str:
    if char.isascii() and char.isprintable():
        return char
    if "\u0300" <= char <= "\u0333":  # accents; from U+0334 on they strike through and change the meaning
        return ""
    return _SPELLED.get(char) or f"<U+{ord(char):04X}>"


_SPELLED = {
    "\N{DEGREE SIGN}": "deg",
    "\N{GREEK SMALL LETTER MU}": "u",
    "\N{MULTIPLICATION SIGN}": "x",
    "\N{DIVISION SIGN}": "/",
    "\N{FRACTION SLASH}": "/",
    "\N{MIDDLE DOT}": "*",
    "\N{DOT OPERATOR}": "*",
    "\N{PLUS-MINUS SIGN}": "+/-",
    "\N{MINUS SIGN}": "-",
    "\N{LESS-THAN OR EQUAL TO}": "<=",
    "\N{GREATER-THAN OR EQUAL TO}": ">=",
    "\N{NOT EQUAL TO}": "<>",
    "\N{RIGHTWARDS ARROW}": "->",
    "\N{LEFTWARDS ARROW}": "<-",
    "\N{HYPHEN}": "-",
    "\N{EN DASH}": "-",
    "\N{EM DASH}": "-",
    "\N{BULLET}": "*",
    "\N{LEFT SINGLE QUOTATION MARK}": "'",
    "\N{RIGHT SINGLE QUOTATION MARK}": "'",
    "\N{LEFT DOUBLE QUOTATION MARK}": '"',
    "\N{RIGHT DOUBLE QUOTATION MARK}": '"',
    "\N{LATIN SMALL LETTER SHARP S}": "ss",
}


def _real(value: float) -> str | None:
    """`1.0`, `1.0E-05`: IEC wants digits on both sides of the point."""
    if not math.isfinite(value):
        return None
    mantissa, mark, exponent = repr(value).partition("e")
    if not mark:
        return mantissa
    return (mantissa if "." in mantissa else f"{mantissa}.0") + "E" + exponent


def _narrow_bytes(data: bytes) -> Iterator[str]:
    for byte in data:
        if chr(byte) in "$'":
            yield "$" + chr(byte)
        else:
            yield chr(byte) if 0x20 <= byte < 0x7F else f"${byte:02X}"


def _wide_units(text: str) -> Iterator[str]:
    data = text.encode("utf-16-be")
    for unit in (int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)):
        if chr(unit) in '$"':
            yield "$" + chr(unit)
        else:
            yield chr(unit) if 0x20 <= unit < 0x7F else f"${unit:04X}"
