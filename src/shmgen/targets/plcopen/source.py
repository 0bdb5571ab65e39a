"""Takes a generated .st file apart into what an IDE stores: declarations, bodies, methods, and the variables in them.

It reads what the templates in `templates/st` write, one declaration a line and comments with `//`, and nothing else.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import dropwhile
from typing import NamedTuple


class Variable(NamedTuple):
    """`name : type := value;`, a member of a structure, or a name of an enumeration, which has no type."""

    name: str
    type: str
    value: str
    comment: str


class Variables(NamedTuple):
    """One section; `keyword` is VAR, VAR_INPUT, VAR_OUTPUT or VAR_GLOBAL."""

    keyword: str
    constant: bool
    variables: tuple[Variable, ...]


class Head(NamedTuple):
    """What stands above an object: its comment, and the attributes with their values."""

    comment: str
    attributes: tuple[tuple[str, str], ...]


class DataType(NamedTuple):
    """A structure, or an enumeration over the type `base`; `text` is all of it."""

    name: str
    head: Head
    members: tuple[Variable, ...]
    base: str
    initial: str
    text: str


class GlobalList(NamedTuple):
    """`text` is all of it."""

    name: str
    head: Head
    variables: Variables
    text: str


class Unit(NamedTuple):
    """A FUNCTION_BLOCK, PROGRAM or METHOD. Its text is `declaration`, `body`, and END_ with `keyword`."""

    keyword: str
    name: str
    access: str
    returns: str
    head: Head
    sections: tuple[Variables, ...]
    declaration: str
    body: str
    methods: tuple[Unit, ...] = ()


def read(name: str, text: str) -> DataType | GlobalList | Unit:
    """The object in the file `name`.st."""
    head, lines = _head(text.splitlines())
    if lines[0].startswith("TYPE "):
        return _data_type(name, head, lines, text)
    if lines[0].startswith("VAR_GLOBAL"):
        return GlobalList(name, head, _section(lines), text.rstrip("\n"))
    units = list(_units(text.splitlines()))
    return units[0]._replace(methods=tuple(units[1:]))


_ATTRIBUTE = re.compile(r"\{attribute '(\w+)'(?: := '([^']*)')?\}")
STRINGS = r"""'(?:[^'$]|\$.)*'|"(?:[^"$]|\$.)*\""""
_COMMENT = r"(?: *//(?P<comment>.*))?"
_VALUE = rf"(?:{STRINGS}|[^;'\"])+"
_VARIABLE = re.compile(rf" *(?P<name>\w+) *: *(?P<type>[^:;]+?)(?: *:= *(?P<value>{_VALUE}))?;{_COMMENT}")
_ENUM_NAME = re.compile(rf" *(?P<name>\w+) *(?P<type>)(?::= *(?P<value>\w+))?,?{_COMMENT}")
_ENUM_END = re.compile(r"\) (?P<base>\w+)(?: := (?P<initial>\w+))?;")
_UNIT = re.compile(
    r"(?P<keyword>FUNCTION_BLOCK|PROGRAM|METHOD)(?: (?P<access>PUBLIC|PRIVATE))? (?P<name>\w+)(?: : (?P<returns>.+))?"
)
_SECTION = re.compile(r"VAR(_INPUT|_OUTPUT)?( CONSTANT)?")


def _head(lines: list[str]) -> tuple[Head, list[str]]:
    """The comment and the attributes, and the lines from the first that is neither."""
    above = 0
    while not lines[above] or lines[above].startswith(("//", "{")):
        above += 1
    comments = [line[2:].strip() for line in lines[:above] if line.startswith("//")]
    attributes = [found.groups(default="") for line in lines[:above] if (found := _ATTRIBUTE.fullmatch(line))]
    return Head("\n".join(comments), tuple((name, value) for name, value in attributes)), lines[above:]


def _data_type(name: str, head: Head, lines: list[str], text: str) -> DataType:
    end = next(number for number, line in enumerate(lines) if line.startswith(("END_STRUCT", ")")))
    pattern = _VARIABLE if lines[end] == "END_STRUCT" else _ENUM_NAME
    found = _ENUM_END.fullmatch(lines[end])
    base, initial = found.groups(default="") if found else ("", "")
    return DataType(name, head, tuple(_variables(lines[2:end], pattern)), base, initial, text.rstrip("\n"))


def _section(lines: list[str]) -> Variables:
    """VAR…, its variables, END_VAR."""
    keyword, _, modifier = lines[0].partition(" ")
    return Variables(keyword, modifier == "CONSTANT", tuple(_variables(lines[1 : lines.index("END_VAR")], _VARIABLE)))


def _variables(lines: Iterable[str], pattern: re.Pattern[str]) -> Iterator[Variable]:
    """The comment of one stands beside it, or in the lines above."""
    above: list[str] = []
    for line in map(str.strip, lines):
        if line.startswith("//"):
            above.append(line[2:].strip())
        elif line:
            found = pattern.fullmatch(line)
            assert found, f"not a declaration: {line}"
            name, type_, value, beside = found.group("name", "type", "value", "comment")
            comment = "\n".join([*above, *([beside.strip()] if beside else [])])
            yield Variable(name, type_, value or "", comment)
            above = []


def _units(lines: list[str]) -> Iterator[Unit]:
    """The block or program, then its methods."""
    while lines := list(dropwhile(lambda line: not line, lines)):
        head, rest = _head(lines)
        found = _UNIT.fullmatch(rest[0])
        assert found, f"not a unit: {rest[0]}"
        keyword, access, name, returns = found.group("keyword", "access", "name", "returns")
        end = rest.index(f"END_{keyword}")
        sections, start = [], 1
        while _SECTION.fullmatch(rest[start]):
            sections.append(_section(rest[start:]))
            start = rest.index("END_VAR", start) + 1
        declaration = "\n".join(lines[: len(lines) - len(rest) + start])
        body = "\n".join(rest[start:end]).strip("\n")
        yield Unit(keyword, name, access or "", returns or "", head, tuple(sections), declaration, body)
        lines = rest[end + 1 :]
