"""Parse the handwritten files in `templates/st` into the objects that an IDE stores, such as blocks and methods.

The text in an IDE must match these files, so the text is extracted, not written a second time. The files follow a
strict style: one declaration per line, and comments with `//`. Any other line is an error. The files contain no text
from definitions except identifiers. Objects with text from definitions are never parsed (objects.py).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import dropwhile

from shmgen.targets.st.objects import Attribute, DataType, GlobalList, Head, Unit, Variable, Variables


class NotInStyle(Exception):
    """A line does not follow the style of the files in templates/st."""


def read(name: str, text: str) -> DataType | GlobalList | Unit:
    """Parse the file `name`.st and return its one object. Raises NotInStyle if a line is not in the strict style."""
    whole = text.splitlines()
    head, lines = _head(whole)
    if lines[0].startswith("TYPE"):
        return _data_type(name, head, lines)
    if lines[0].startswith("VAR_GLOBAL"):
        section, rest = _section(lines)
        _expect(not rest, "the end of the file", rest)
        return GlobalList(name, head, section)
    unit, *methods = _units(whole)
    _expect(unit.name == name, name, [unit.name])
    _expect(all(method.keyword == "METHOD" for method in methods), "METHOD", [method.keyword for method in methods])
    return unit._replace(methods=tuple(methods))


_ATTRIBUTE = re.compile(r"\{attribute '(\w+)'(?: := '([^']*)')?\}")
_COMMENT = r"(?: *(?P<comment>//.*))?"
_VALUE = r"""(?:'(?:[^'$]|\$.)*'|"(?:[^"$]|\$.)*"|[^;'"\[])+"""
_VARIABLE = re.compile(rf" *(?P<name>\w+) *: *(?P<type>[^:;]+?)(?: *:= *(?P<value>{_VALUE}))?;{_COMMENT}")
_ENUM_NAME = re.compile(rf" *(?P<name>\w+) *(?P<type>)(?::= *(?P<value>\w+))?,?{_COMMENT}")
_ENUM_END = re.compile(r"\) (?P<base>\w+)(?: := (?P<initial>\w+))?;")
_UNIT = re.compile(
    r"(?P<keyword>FUNCTION_BLOCK|PROGRAM|METHOD)(?: (?P<access>PUBLIC|PRIVATE))? (?P<name>\w+)(?: : (?P<returns>.+))?"
)
_SECTION = re.compile(r"(?P<keyword>VAR|VAR_INPUT|VAR_OUTPUT|VAR_GLOBAL)(?P<constant> CONSTANT)?")


def _expect(true: object, what: str, lines: list[str]) -> None:
    if not true:
        raise NotInStyle(f"expected {what}, found {lines[0] if lines else 'the end of the file'!r}")


def _head(lines: list[str]) -> tuple[Head, list[str]]:
    """Return the comment and attributes at the top, and the remaining lines."""
    comment, attributes = [], []
    for number, line in enumerate(lines):
        if line.startswith("//"):
            comment.append(line)
        elif match := _ATTRIBUTE.fullmatch(line):
            attributes.append(Attribute(match[1], match[2] or ""))
        elif line:
            return Head(tuple(comment), tuple(attributes)), lines[number:]
    raise NotInStyle("nothing but comments")


def _data_type(name: str, head: Head, lines: list[str]) -> DataType:
    opened, *_, closed, end = lines[1:] if len(lines) > 3 else ["", "", ""]
    _expect((lines[0], end) == (f"TYPE {name} :", "END_TYPE"), f"TYPE {name} : and END_TYPE", [lines[0]])
    if (opened, closed) == ("STRUCT", "END_STRUCT"):
        return DataType(name, head, tuple(_variables(lines[2:-2], _VARIABLE)))
    match = _ENUM_END.fullmatch(closed)
    _expect(opened == "(" and match, "a structure or an enumeration", [opened])
    assert match
    return DataType(name, head, tuple(_variables(lines[2:-2], _ENUM_NAME)), match["base"], match["initial"] or "")


def _section(lines: list[str]) -> tuple[Variables, list[str]]:
    """Return the section from VAR to END_VAR, and the lines after the section."""
    match = _SECTION.fullmatch(lines[0])
    _expect(match and "END_VAR" in lines, "a section of variables", lines)
    assert match
    end = lines.index("END_VAR")
    variables = tuple(_variables(lines[1:end], _VARIABLE))
    return Variables(match["keyword"], bool(match["constant"]), variables), lines[end + 1 :]


def _variables(lines: Iterable[str], pattern: re.Pattern[str]) -> Iterator[Variable]:
    """Yield the variables with their comments. A comment stands beside its variable or in the lines above."""
    above: list[str] = []
    for line in map(str.strip, lines):
        if line.startswith("//"):
            above.append(line)
        elif line:
            variable = _variable(line, pattern)
            yield variable._replace(comment=(*above, *variable.comment))
            above = []


def _variable(line: str, pattern: re.Pattern[str]) -> Variable:
    """Return the variable in a line, with the comment beside it."""
    match = pattern.fullmatch(line)
    _expect(match, "a declaration", [line])
    assert match
    name, type_, value, comment = match.group("name", "type", "value", "comment")
    return Variable(name, type_, value or "", (comment,) if comment else ())


def _units(lines: list[str]) -> Iterator[Unit]:
    """Split the lines of a handwritten file of Structured Text: yield its block or program, then each method."""
    while lines := list(dropwhile(lambda line: not line, lines)):
        head, rest = _head(lines)
        match = _UNIT.fullmatch(rest[0])
        _expect(match and f"END_{match['keyword']}" in rest, "a whole block, program or method", rest)
        assert match
        sections, body = [], rest[1:]
        while body[0].startswith("VAR"):
            section, body = _section(body)
            sections.append(section)
        end = body.index(f"END_{match['keyword']}")
        yield Unit(
            match["keyword"],
            match["name"],
            match["access"] or "",
            match["returns"] or "",
            head,
            tuple(sections),
            declaration="\n".join(lines[: len(lines) - len(body)]),
            body="\n".join(body[:end]).strip("\n"),
        )
        lines = body[end + 1 :]
