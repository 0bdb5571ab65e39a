r"""Turns the text behind a name, `0x10` or `["a", 'b']`, into the value of a default or a constant.

Whole numbers are read as rosidl_adapter and genmsg read them, with Python's `int`: `010` is ten; `0x10`, `0o20` and
`0b10000` are sixteen. Within quotes `#` and `=` are ordinary, and `\\ \" \' \n \r \t` are escapes.
"""

from __future__ import annotations

import math
import re

from shmgen.core.model import (
    Array,
    Clock,
    Default,
    Element,
    FieldType,
    Ref,
    Scalar,
    Sequence,
    String,
    Value,
    assert_never,
)
from shmgen.core.plural import counted
from shmgen.definitions.tokens import Dialect, Token, shown


def read_default(rest: Token, type: FieldType) -> tuple[Default, Token]:
    """The default, and what stands behind it: nothing or a comment. Raises Wrong: SHM003, SHM005 or SHM006."""
    if not isinstance(type, Array | Sequence):
        return _single(rest, type)
    listed = _LIST.match(rest.text)
    if listed is None:
        raise rest.wrong("SHM006", "the default of an array is a list", "write `[1, 2, 3]`, with the brackets")
    written = rest.part(0, listed.end())
    elements = _elements(written, isinstance(type.element, String))
    if isinstance(type, Array) and len(elements) != type.length:
        raise written.wrong("SHM006", f"{counted(len(elements), 'element')}, where exactly {type.length} belong")
    if isinstance(type, Sequence) and type.capacity is not None and len(elements) > type.capacity:
        raise written.wrong("SHM006", f"{counted(len(elements), 'element')}, where at most {type.capacity} belong")
    return tuple(_value(element, type.element) for element in elements), rest.part(listed.end())


def read_constant(rest: Token, type: FieldType, dialect: Dialect) -> tuple[Value, Token]:
    """The value, and what stands behind it. Raises Wrong: SHM003, SHM005 or SHM006."""
    if dialect == "ros1" and isinstance(type, String):
        return rest.text, rest.part(len(rest.text))  # up to the end of the line, quotes and `#` included
    if isinstance(type, Array | Sequence):
        raise rest.wrong("SHM006", "a constant is a single number, bool or string")
    return _single(rest, type)


_QUOTED = r""""(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'"""
_STRING = re.compile(_QUOTED)
_LIST = re.compile(rf"""\[(?:{_QUOTED}|[^"'\]#])*\]""")
_ELEMENT = re.compile(rf"""{_QUOTED}|[^"',]*""")
_BLANKS = re.compile(r"[ \t]*")
_ESCAPE = re.compile(r"\\(.)")
_ESCAPED = {"\\": "\\", '"': '"', "'": "'", "n": "\n", "r": "\r", "t": "\t"}
_WHOLE = re.compile(r"[+-]?(?:0[xX][0-9a-fA-F]+|0[bB][01]+|0[oO][0-7]+|[0-9]+)")
_REAL = re.compile(r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE)
_BOOL = {"true": True, "1": True, "false": False, "0": False}
_LONGEST_NUMBER = 400
"""Characters; a float64 written out in full has 309 digits before the point."""
_TOO_LARGE_FOR_FLOAT32 = (2 - 2**-24) * 2.0**127
"""From here on IEEE 754 rounds to infinity."""


def _single(rest: Token, type: Element) -> tuple[Value, Token]:
    if isinstance(type, String) and rest.text[:1] in ("'", '"'):
        quoted = _STRING.match(rest.text)
        if quoted is None:
            raise rest.wrong("SHM003", "the quote is never closed", f"close it with {rest.text[0]}")
        end = quoted.end()
    else:
        end = len(rest.text.partition("#")[0])
    return _value(rest.part(0, end), type), rest.part(end)


def _elements(written: Token, are_strings: bool) -> list[Token]:
    """Those of `[a, b]`. As in rosidl_adapter, a comma at the end of strings ends the list, and no two touch.

    Behind one at the end of numbers an empty element follows, which no number takes.
    """
    inside = written.part(1, len(written.text) - 1)
    tokens: list[Token] = []
    position = 0
    while position < len(inside.text) or (position == len(inside.text) and inside.text.endswith(",")):
        start = _end(_BLANKS, inside.text, position)
        if are_strings and start == len(inside.text):
            break
        end = _end(_ELEMENT, inside.text, start)
        if are_strings and start == end:
            raise inside.part(start).wrong("SHM003", "expected a value before the comma", 'an empty one is ""')
        tokens.append(inside.part(start, end))
        position = _end(_BLANKS, inside.text, end)
        if inside.text[position : position + 1] not in (",", ""):
            raise inside.part(position).wrong("SHM003", "expected a comma between the elements of the list")
        position += 1
    return tokens


def _end(pattern: re.Pattern[str], text: str, start: int) -> int:
    """Where a pattern that takes the empty text too stops."""
    found = pattern.match(text, start)
    return found.end() if found else start


def _value(written: Token, type: Element) -> Value:
    match type:
        case Scalar.BOOL:
            if written.text.lower() not in _BOOL:
                raise _not_a(written, "bool", "write `true` or `false`")
            return _BOOL[written.text.lower()]
        case Scalar.FLOAT32 | Scalar.FLOAT64:
            return _real(written, type)
        case Scalar():
            return _whole(written, type)
        case String():
            return _string(written, type)
        case Clock() | Ref():
            raise written.wrong("SHM006", "only numbers, bools and strings take a value here", "leave the value out")
        case _:
            assert_never(type)


def _whole(written: Token, type: Scalar) -> int:
    assert type.range is not None
    if not _WHOLE.fullmatch(written.text):
        raise _not_a(written, type.value, "write a whole number, such as `10` or `0x10`")
    digits = written.text.lstrip("+-")
    base = {"x": 16, "b": 2, "o": 8}.get(digits[1:2].lower(), 10)
    least, most = type.range
    value = int(digits, base) if len(digits) <= _LONGEST_NUMBER else most + 1
    value = -value if written.text.startswith("-") else value
    if not least <= value <= most:
        raise written.wrong("SHM005", f"{shown(written.text)} is not in {least}..{most}, the range of {type.value}")
    return value


def _real(written: Token, type: Scalar) -> float:
    if not _REAL.fullmatch(written.text):
        raise _not_a(written, type.value, "write a number with a point, such as `0.5`")
    value = float(written.text) if len(written.text) <= _LONGEST_NUMBER else math.inf
    infinite = math.isinf(value) and "inf" not in written.text.lower()
    if infinite or (type is Scalar.FLOAT32 and _TOO_LARGE_FOR_FLOAT32 <= abs(value) < math.inf):
        raise written.wrong("SHM005", f"{shown(written.text)} is more than {type.value} can hold")
    return value


def _string(written: Token, type: String) -> str:
    text = written.text
    if text[:1] in ("'", '"'):
        text = _ESCAPE.sub(lambda escape: _ESCAPED.get(escape[1], escape[0]), text[1:-1])
    size = len(text.encode("utf-16-le")) // 2 if type.wide else len(text.encode())
    if type.capacity is not None and size > type.capacity:
        raise written.wrong("SHM005", f"{counted(size, 'character')}, where at most {type.capacity} fit")
    return text


def _not_a(written: Token, type: str, hint: str) -> Exception:
    return written.wrong("SHM006", f"{shown(written.text)} is not a valid {type}" if written.text else "no value", hint)
