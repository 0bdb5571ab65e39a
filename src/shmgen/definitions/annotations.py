r"""Split the text of an .idl file into the code for rosidl_parser and a list of annotations.

Comments, `#include` and annotations such as `@unit (value="m")` become blanks, so that every word keeps its position.
rosidl_parser would spend most of its time on annotations.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from shmgen.definitions.tokens import Line, Token


class Annotation(NamedTuple):
    """An annotation such as `@default (value=5)`, which begins at character `start`.

    `values` are spelled as in the file. A value without a name has the name `value`.
    """

    start: int
    name: str
    values: Mapping[str, str]


class Text(NamedTuple):
    """The text of an .idl file, which converts a position in the whole text to a line and a column.

    A position counts characters from the beginning of the text.
    """

    lines: Sequence[Line]
    whole: str

    def token(self, start: int, word: str) -> Token:
        line = self.lines[self.whole.count("\n", 0, start)]
        return Token(line, start - self.whole.rfind("\n", 0, start) - 1, word)


def extract_annotations(source: Text) -> tuple[str, list[Annotation]]:
    """Return the code without comments and annotations, and the annotations in order.

    Raises DefinitionError (SHM003) if the syntax is invalid, or if shmgen does not support the syntax.
    """
    for match in _STRING_OR_OUT.finditer(source.whole):
        if match["unclosed"]:
            raise source.token(match.start(), match[0]).error("SHM003", "the end of this string or comment is missing")
    code = _STRING_OR_OUT.sub(lambda match: _blank(match) if match["out"] else match[0], source.whole)
    annotations = []
    for match in _ANNOTATION.finditer(code):
        if match["values"] is None and _BRACKET.match(code, match.end()):
            raise source.token(match.start(), match[0]).error("SHM003", "the closing bracket after this is missing")
        values = {part["key"] or "value": part["value"].strip() for part in _VALUE.finditer(match["values"] or "")}
        annotations.append(Annotation(match.start(), match["name"], values))
    code = _ANNOTATION.sub(_blank, code)
    bare = _STRING.sub(_blank, code)
    if other := _OTHER_THAN_STRUCT.search(bare):
        hint = "write a message as a struct, a service to a .srv file, an action to an .action file"
        raise source.token(other.start(), other[1]).error("SHM003", f"ROS has no {other[1]}", hint)
    if sign := _ARITHMETIC.search(bare):
        place = source.token(sign.start("sign"), sign["sign"])
        hint = "write the result as a number, and a type as `package::msg::Name`"
        raise place.error("SHM003", "an expression is not allowed here", hint)
    return code, annotations


def to_msg_literal(literal: str) -> str:
    """Convert a literal of IDL to the syntax of a .msg file: `TRUE` -> `true`, `017` -> `0o17`, `"a" "b"` -> `"ab"`."""
    if _STRING.match(literal):
        return '"' + text_of(literal).replace("\\", r"\\").replace('"', r"\"") + '"'
    if literal in ("TRUE", "FALSE"):
        return literal.lower()
    if _OCTAL.fullmatch(literal):
        return literal.replace("0", "0o", 1)
    return literal[:-1] if literal[-1:] in ("d", "D") and literal[:1].isdigit() else literal


def text_of(literal: str) -> str:
    """Return the characters of quoted strings, concatenated."""
    return "".join(_ESCAPE.sub(_character, inner) for inner in _STRING.findall(literal))


_QUOTED = r'L?"(?:\\.|[^"\\\n])*"'
_STRING = re.compile(r'L?"((?:\\.|[^"\\\n])*)"')
_STRING_OR_OUT = re.compile(
    rf'{_QUOTED}|(?P<out>//[^\n]*|/\*(?:[^*]|\*(?!/))*\*/|(?m:^[ \t]*\#include\b[^\n]*))|(?P<unclosed>/\*|")'
)
_ANNOTATION = re.compile(rf'@\s*(?P<name>\w+)(?:\s*(?P<values>\((?:[^"()]|{_QUOTED})*\)))?')
_BRACKET = re.compile(r"\s*\(")
_VALUE = re.compile(rf'(?:(?P<key>\w+)\s*=\s*)?(?P<value>(?:{_QUOTED}\s*)+|[^\s,"()=][^,"()]*)')
_OTHER_THAN_STRUCT = re.compile(r"\b(union|interface|valuetype|exception|bitmask|bitset)\s+\w")
# A sign after a word is an addition, except the sign of an exponent.
_ARITHMETIC = re.compile(r"(?:(?<![0-9.][eE])(?<=\w)\s*(?=[+-])|(?=[|^&*/%~()]))(?P<sign>.)")
_OCTAL = re.compile(r"[+-]?0[0-7]+")
_ESCAPE = re.compile(r"\\(?:x(?P<hex>[0-9a-fA-F]{1,2})|u(?P<wide>[0-9a-fA-F]{1,4})|(?P<octal>[0-7]{1,3})|(?P<sign>.))")
"""The escape sequences of OMG IDL 4.2, table 7-9."""
_SIGNS = {"n": "\n", "t": "\t", "r": "\r", "\\": "\\", "?": "?", "'": "'", '"': '"'}


def _character(escape: re.Match[str]) -> str:
    """Return the character that an escape sequence stands for.

    Return the escape sequence unchanged if it stands for a control character or half of a surrogate pair.
    """
    if escape["sign"]:
        return _SIGNS.get(escape["sign"], escape[0])
    character = chr(int(escape["octal"], 8) if escape["octal"] else int(escape["hex"] or escape["wide"], 16))
    return character if character.isprintable() or character in "\n\t\r" else escape[0]


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", match[0])
