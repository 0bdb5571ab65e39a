r"""Parse the text after a name, such as `0x10` or `["a", 'b']`, into the value of a default or a constant.

Whole numbers are read as in rosidl_adapter and genmsg, with Python's `int`: `010` is ten; `0x10`, `0o20` and
`0b10000` are sixteen. Within quotes `#` and `=` are ordinary characters, and `\\ \" \' \n \r \t` are escapes.
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
    text_length,
)
from shmgen.core.plural import counted
from shmgen.definitions.tokens import Dialect, Token, quote


def read_default(rest: Token, type: FieldType) -> tuple[Default, Token]:
    """Parse the default of a field. Return its value, and the text after the default: a comment or nothing.

    Raises DefinitionError (SHM003, SHM005 or SHM006) if the default is invalid.
    """
    if not isinstance(type, Array | Sequence):
        return _single_value(rest, type)
    listed = _LIST.match(rest.text)
    if listed is None:
        raise rest.error("SHM006", "the default of an array must be a list", "write `[1, 2, 3]`, with the brackets")
    written = rest.part(0, listed.end())
    elements = _elements(written, isinstance(type.element, String))
    if isinstance(type, Array) and len(elements) != type.length:
        raise written.error("SHM006", f"{counted(len(elements), 'element')}, but the array has {type.length}")
    if isinstance(type, Sequence) and type.capacity is not None and len(elements) > type.capacity:
        raise written.error("SHM006", f"{counted(len(elements), 'element')}, but the bound is {type.capacity}")
    return tuple(_value(element, type.element) for element in elements), rest.part(listed.end())


def read_constant(rest: Token, type: Scalar | String, dialect: Dialect) -> tuple[Value, Token]:
    """Parse the value of a constant. Return the value, and the text after the value.

    Raises DefinitionError (SHM003, SHM005 or SHM006) if the value is invalid.
    """
    if dialect == "ros1" and isinstance(type, String):
        return rest.text, rest.part(len(rest.text))  # the rest of the line, with quotes and `#`
    return _single_value(rest, type)


_QUOTED = r""""(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'"""
_STRING = re.compile(_QUOTED)
_LIST = re.compile(rf"""\[(?:{_QUOTED}|[^"'\]#])*\]""")
_ELEMENT = re.compile(rf"""[ \t]*(?P<value>{_QUOTED}|[^"',]*)[ \t]*(?P<behind>(?s:.)|\Z)""")
_ESCAPE = re.compile(r"\\(.)")
_ESCAPED = {"\\": "\\", '"': '"', "'": "'", "n": "\n", "r": "\r", "t": "\t"}
_WHOLE = re.compile(r"[+-]?(?:0[xX][0-9a-fA-F]+|0[bB][01]+|0[oO][0-7]+|[0-9]+)")
_REAL = re.compile(r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE)
_BOOL = {"true": True, "1": True, "false": False, "0": False}
_LONGEST_NUMBER = 400
"""The longest number in characters. A float64 written out in full has 309 digits before the point."""
_TOO_LARGE_FOR_FLOAT32 = (2 - 2**-24) * 2.0**127
"""The smallest number that IEEE 754 rounds to infinity in a float32."""


def _single_value(rest: Token, type: Element) -> tuple[Value, Token]:
    if isinstance(type, String) and rest.text[:1] in ("'", '"'):
        literal = _STRING.match(rest.text)
        if literal is None:
            raise rest.error("SHM003", "the closing quote is missing", f"end the text with {rest.text[0]}")
        end = literal.end()
    else:
        end = len(rest.text.partition("#")[0])
    return _value(rest.part(0, end), type), rest.part(end)


def _elements(written: Token, are_strings: bool) -> list[Token]:
    """Split a list `[a, b]` into its elements.

    In a list of strings, a comma may end the list and empty elements are rejected, as in rosidl_adapter. In a list of
    numbers, a comma at the end adds an empty element, which the caller rejects because a number is required.
    """
    inside = written.part(1, len(written.text) - 1)
    tokens: list[Token] = []
    for element in _ELEMENT.finditer(inside.text) if inside.text else ():
        start, end = element.span("value")
        if are_strings and start == len(inside.text):
            break
        if are_strings and start == end:
            reason = "expected a value before the comma"
            raise inside.part(start).error("SHM003", reason, 'write "" for an empty string')
        tokens.append(inside.part(start, end))
        if not element["behind"]:
            break
        if element["behind"] != ",":
            reason = "expected a comma between the elements of the list"
            raise inside.part(element.start("behind")).error("SHM003", reason)
    return tokens


def _value(written: Token, type: Element) -> Value:
    match type:
        case Scalar.BOOL:
            if written.text.lower() not in _BOOL:
                raise _type_error(written, "bool", "write `true` or `false`")
            return _BOOL[written.text.lower()]
        case Scalar.FLOAT32 | Scalar.FLOAT64:
            return _float(written, type)
        case Scalar():
            return _integer(written, type)
        case String():
            return _string(written, type)
        case Clock() | Ref():
            raise written.error("SHM006", "only numbers, bools and strings take a value here", "remove the value")
        case _:
            assert_never(type)


def _integer(written: Token, type: Scalar) -> int:
    assert type.range is not None
    if not _WHOLE.fullmatch(written.text):
        raise _type_error(written, type.value, "write a whole number, such as `10` or `0x10`")
    digits = written.text.lstrip("+-")
    base = {"x": 16, "b": 2, "o": 8}.get(digits[1:2].lower(), 10)
    least, most = type.range
    value = int(digits, base) if len(digits) <= _LONGEST_NUMBER else most + 1
    value = -value if written.text.startswith("-") else value
    if not least <= value <= most:
        raise written.error("SHM005", f"{quote(written.text)} is not in {least}..{most}, the range of {type.value}")
    return value


def _float(written: Token, type: Scalar) -> float:
    if not _REAL.fullmatch(written.text):
        raise _type_error(written, type.value, "write a number with a point, such as `0.5`")
    value = float(written.text) if len(written.text) <= _LONGEST_NUMBER else math.inf
    infinite = math.isinf(value) and "inf" not in written.text.lower()
    if infinite or (type is Scalar.FLOAT32 and _TOO_LARGE_FOR_FLOAT32 <= abs(value) < math.inf):
        raise written.error("SHM005", f"{quote(written.text)} is too large for {type.value}")
    return value


def _string(written: Token, type: String) -> str:
    text = written.text
    if text[:1] in ("'", '"'):
        text = _ESCAPE.sub(lambda escape: _ESCAPED.get(escape[1], escape[0]), text[1:-1])
    size = text_length(text, type, "utf-8")
    if type.capacity is not None and size > type.capacity:
        raise written.error("SHM005", f"{counted(size, 'character')}, but the bound is {type.capacity}")
    return text


def _type_error(written: Token, type: str, hint: str) -> Exception:
    return written.error("SHM006", f"{quote(written.text)} is not a valid {type}" if written.text else "no value", hint)
