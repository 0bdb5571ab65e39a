r"""Turns the text of an .idl file into what rosidl_parser has to read of it, and the annotations by themselves.

Comments, `#include` and annotations such as `@unit (value="m")` become blanks, so that every word keeps its place: in
the grammar of rosidl_parser annotations take most of the time.
"""

from __future__ import annotations

import re
from bisect import bisect
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from shmgen.core.fast_dataclass import dataclass
from shmgen.definitions.tokens import Line, Token


class Annotation(NamedTuple):
    """`@default (value=5)` from character `start` on; the values as they are spelled, one without a name as `value`."""

    start: int
    name: str
    values: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Text:
    """A text whose places are counted in characters from its beginning; `starts` are those of its lines."""

    lines: Sequence[Line]
    starts: Sequence[int]
    whole: str

    @classmethod
    def of(cls, lines: Sequence[Line]) -> Text:
        starts = [0]
        for line in lines[:-1]:
            starts.append(starts[-1] + len(line.text) + 1)
        return cls(lines, starts, "\n".join(line.text for line in lines))

    def token(self, start: int, word: str) -> Token:
        number = bisect(self.starts, start) - 1
        return Token(self.lines[number], start - self.starts[number], word)


def take_out(source: Text) -> tuple[str, list[Annotation]]:
    """What is left, and the annotations in order. Raises Wrong: SHM003, also for what is valid and not read here."""
    for found in _STRING_OR_OUT.finditer(source.whole):
        if found["unclosed"]:
            raise source.token(found.start(), found[0]).wrong("SHM003", "this is never closed")
    code = _STRING_OR_OUT.sub(lambda found: _blank(found) if found["out"] else found[0], source.whole)
    annotations = []
    for found in _ANNOTATION.finditer(code):
        if found["values"] is None and _BRACKET.match(code, found.end()):
            raise source.token(found.start(), found[0]).wrong("SHM003", "the bracket behind this is never closed")
        values = {part["key"] or "value": part["value"].strip() for part in _VALUE.finditer(found["values"] or "")}
        annotations.append(Annotation(found.start(), found["name"], values))
    code = _ANNOTATION.sub(_blank, code)
    bare = _STRING.sub(_blank, code)
    if other := _OTHER_THAN_STRUCT.search(bare):
        hint = "a message is a struct, a service a .srv, an action an .action"
        raise source.token(other.start(), other[1]).wrong("SHM003", f"ROS has no {other[1]}", hint)
    if sign := _ARITHMETIC.search(bare):
        place = source.token(sign.start("sign"), sign["sign"])
        raise place.wrong("SHM003", "nothing is calculated here", "write the result")
    return code, annotations


def spelled(literal: str) -> str:
    """A literal of IDL as a .msg spells it: `TRUE` -> `true`, `017` -> `0o17`, `"a" "b"` -> `"ab"`."""
    if _STRING.match(literal):
        return '"' + text_of(literal).replace("\\", r"\\").replace('"', r"\"") + '"'
    if literal in ("TRUE", "FALSE"):
        return literal.lower()
    if _OCTAL.fullmatch(literal):
        return literal.replace("0", "0o", 1)
    return literal[:-1] if literal[-1:] in ("d", "D") and literal[:1].isdigit() else literal


def text_of(literal: str) -> str:
    """The characters of strings in quotes, one behind the other."""
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
# A sign behind a word adds, unless it is that of an exponent.
_ARITHMETIC = re.compile(r"(?:(?<![0-9.][eE])(?<=\w)\s*(?=[+-])|(?=[|^&*/%~()]))(?P<sign>.)")
_OCTAL = re.compile(r"[+-]?0[0-7]+")
_ESCAPE = re.compile(r"\\(?:x(?P<hex>[0-9a-fA-F]{1,2})|u(?P<wide>[0-9a-fA-F]{1,4})|(?P<octal>[0-7]{1,3})|(?P<sign>.))")
"""OMG IDL 4.2, table 7-9."""
_SIGNS = {"n": "\n", "t": "\t", "r": "\r", "\\": "\\", "?": "?", "'": "'", '"': '"'}


def _character(escape: re.Match[str]) -> str:
    """Control characters, and halves of surrogate pairs, stay as they are spelled."""
    if escape["sign"]:
        return _SIGNS.get(escape["sign"], escape[0])
    character = chr(int(escape["octal"], 8) if escape["octal"] else int(escape["hex"] or escape["wide"], 16))
    return character if character.isprintable() or character in "\n\t\r" else escape[0]


def _blank(found: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", found[0])
