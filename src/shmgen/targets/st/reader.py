"""Takes what is written by hand in `templates/st` apart into what an IDE stores: declarations, bodies, methods.

Those files are the source of their blocks, and the text in them is what an IDE shall show, so it is cut and not written
a second time. The style is strict, one declaration a line and comments with `//`; anything else is an error. Nothing of
the user's but identifiers stands in them; what holds the words of a definition comes as data (objects.py).
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Iterator
from itertools import dropwhile

from shmgen.targets.st.objects import Attribute, DataType, GlobalList, Head, Unit, Variable, Variables


class NotInStyle(Exception):
    """A line that is not written as those in templates/st are."""


def read(name: str, text: str) -> DataType | GlobalList | Unit:
    """The one object in the file `name`.st. Raises NotInStyle."""
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
_COMMENT = r"(?: *//(?P<comment>.*))?"
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
        raise NotInStyle(f"{lines[0] if lines else 'the end of the file'!r} where there should be {what}")


def _head(lines: list[str]) -> tuple[Head, list[str]]:
    """The comment and the attributes, and the lines from the first that is neither."""
    comment, attributes = [], []
    for number, line in enumerate(lines):
        if line.startswith("//"):
            comment.append(line[2:].strip())
        elif found := _ATTRIBUTE.fullmatch(line):
            attributes.append(Attribute(found[1], found[2] or ""))
        elif line:
            return Head(tuple(comment), tuple(attributes)), lines[number:]
    raise NotInStyle("nothing but comments")


def _data_type(name: str, head: Head, lines: list[str]) -> DataType:
    opened, *_, closed, end = lines[1:] if len(lines) > 3 else ["", "", ""]
    _expect((lines[0], end) == (f"TYPE {name} :", "END_TYPE"), f"TYPE {name} : and END_TYPE", [lines[0]])
    if (opened, closed) == ("STRUCT", "END_STRUCT"):
        return DataType(name, head, tuple(_variables(lines[2:-2], _VARIABLE)))
    found = _ENUM_END.fullmatch(closed)
    _expect(opened == "(" and found, "a structure or an enumeration", [opened])
    assert found
    return DataType(name, head, tuple(_variables(lines[2:-2], _ENUM_NAME)), found["base"], found["initial"] or "")


def _section(lines: list[str]) -> tuple[Variables, list[str]]:
    """VAR..., its variables, END_VAR; and the lines behind."""
    found = _SECTION.fullmatch(lines[0])
    _expect(found and "END_VAR" in lines, "a section of variables", lines)
    assert found
    end = lines.index("END_VAR")
    variables = tuple(_variables(lines[1:end], _VARIABLE))
    return Variables(found["keyword"], bool(found["constant"]), variables), lines[end + 1 :]


def _variables(lines: Iterable[str], pattern: re.Pattern[str]) -> Iterator[Variable]:
    """The comment of one stands beside it, or in the lines above."""
    above: list[str] = []
    for line in map(str.strip, lines):
        if line.startswith("//"):
            above.append(line[2:].strip())
        elif line:
            variable = _variable(line, pattern)
            if above:
                beside = [variable.comment] if variable.comment else []
                variable = variable._replace(comment="\n".join([*above, *beside]))
            yield variable
            above = []


@functools.lru_cache(4096)  # most stand in many blocks
def _variable(line: str, pattern: re.Pattern[str]) -> Variable:
    """With the comment beside it."""
    found = pattern.fullmatch(line)
    _expect(found, "a declaration", [line])
    assert found
    name, type_, value, comment = found.group("name", "type", "value", "comment")
    return Variable(name, type_, value or "", (comment or "").strip())


def _units(lines: list[str]) -> Iterator[Unit]:
    """The block or program, then its methods."""
    while lines := list(dropwhile(lambda line: not line, lines)):
        head, rest = _head(lines)
        found = _UNIT.fullmatch(rest[0])
        _expect(found and f"END_{found['keyword']}" in rest, "a whole block, program or method", rest)
        assert found
        sections, body = [], rest[1:]
        while body[0].startswith("VAR"):
            section, body = _section(body)
            sections.append(section)
        end = body.index(f"END_{found['keyword']}")
        yield Unit(
            found["keyword"],
            found["name"],
            found["access"] or "",
            found["returns"] or "",
            head,
            tuple(sections),
            declaration="\n".join(lines[: len(lines) - len(body)]),
            body="\n".join(body[:end]).strip("\n"),
        )
        lines = body[end + 1 :]
