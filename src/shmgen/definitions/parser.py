"""Turns the text of a .msg, .srv or .action file into Messages that know the place of every word.

One declaration a line, as rosidl_adapter (ROS 2) and genmsg (ROS 1) read them. Where those two differ from each other
or fall over, docs/grammar.md says what is done here.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Constant, Default, Field, FieldType, Message, Scalar, String, TypeName
from shmgen.core.plural import counted
from shmgen.definitions import comments, habits
from shmgen.definitions.fieldtypes import read_type, type_word
from shmgen.definitions.literals import read_constant, read_default
from shmgen.definitions.tokens import Dialect, Line, Token, Wrong, shown

SECTIONS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
"""Kind -> the endings of the messages in such a file."""


class Source(NamedTuple):
    """`name` is that of the file (std_srvs/srv/SetBool); `path` is for diagnostics, `origin` for what is generated."""

    name: TypeName
    text: str
    path: str
    origin: str


def parse(source: Source, dialect: Dialect, report: Report) -> tuple[Message, ...]:
    """One message for a .msg, two for a .srv, three for an .action; what is wrong goes to the report.

    SHM003, SHM005, SHM006, SHM102, SHM201, SHM202, SHM302. The first 20 findings of a file are told.
    """
    lines = lines_of(source, report)
    if not lines:
        return ()
    name = source.name
    if not _MESSAGE_NAME[dialect].fullmatch(name.name):
        hint = "name the file in CamelCase: a capital first, then letters and digits"
        report.error("SHM202", f"{shown(name.name)} is not a message name", Span(source.path), hint=hint)
        return ()
    endings = SECTIONS[name.kind]
    breaks = [index for index, line in enumerate(lines) if _SEPARATOR.fullmatch(line.text)]
    if len(breaks) != len(endings) - 1:
        culprit = lines[breaks[len(endings) - 1]].span(0, 3) if len(breaks) >= len(endings) else lines[-1].span()
        message = f"a .{name.kind} file has {counted(len(endings), 'part')}, this one {len(breaks) + 1}"
        hint = (
            "parts are separated by a line `---`"
            if endings[1:]
            else "a service is a .srv in srv/, an action an .action in action/"
        )
        report.error("SHM003", message, culprit, hint=hint)
        return ()
    starts, ends = [0, *(index + 1 for index in breaks)], [*breaks, len(lines)]
    return tuple(
        _message(lines[start:end], TypeName(name.package, name.kind, name.name + ending), source, dialect, report)
        for start, end, ending in zip(starts, ends, endings, strict=True)
    )


def lines_of(source: Source, report: Report) -> list[Line]:
    """Of the text; none, and SHM003 in the report, where a control character is among them."""
    text = source.text.replace("\r\n", "\n").replace("\r", "\n")
    lines = [Line(source.path, number, line) for number, line in enumerate(text.split("\n"), 1)]
    for line in lines if _CONTROL.search(text) else ():
        if control := _CONTROL.search(line.text):
            code = f"U+{ord(control[0]):04X}"
            report.error("SHM003", f"control character {code}", line.span(control.start(), 1), hint="take it out")
            return []
    return lines


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")
_SEPARATOR = re.compile(r"---+[ \t]*(?:#.*)?")
_DECLARATION = re.compile(r"[ \t]*(?P<type>[^ \t#=][^ \t#]*)(?:[ \t]+(?P<name>[^ \t#=]+))?[ \t]*(?P<rest>.*)")
# The patterns of rosidl_adapter/parser.py and genmsg/names.py, restated so that none can backtrack.
_LOWER = re.compile(r"[a-z](?:_?[a-z0-9])*")
_UPPER = re.compile(r"[A-Z](?:_?[A-Z0-9])*")
_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_FIELD_NAME = {"ros1": _WORD, "ros2": _LOWER}
_CONSTANT_NAME = {"ros1": _WORD, "ros2": _UPPER}
_MESSAGE_NAME = {"ros1": _WORD, "ros2": re.compile(r"[A-Z][A-Za-z0-9]*")}


class _Declaration(NamedTuple):
    """A field, or a constant where `is_constant`: then `value` is no None."""

    written: Token
    name: Token
    type: FieldType
    value: Default | None
    is_constant: bool
    comment: str


def _message(lines: list[Line], name: TypeName, source: Source, dialect: Dialect, report: Report) -> Message:
    declarations = _declarations(lines, name, dialect, report)
    texts = [line.text for line in lines]
    first = lines[0].number if lines else 0
    doc, docs = comments.assign(texts, {number - first: found.comment for number, found in declarations.items()})
    fields: list[Field] = []
    constants: list[Constant] = []
    for number, (written, word, type, value, is_constant, _) in declarations.items():
        about, own = comments.own_of(docs[number - first])
        if is_constant:
            assert isinstance(type, Scalar | String)
            assert isinstance(value, bool | int | float | str)
            constants.append(Constant(word.text, type, value, word.span, about, own))
        else:
            about, unit = comments.unit_of(about)
            spelled = "byte" if type_word(written.text) == "byte" else ""  # a `char` of a .msg is an uint8 to ROS 2
            fields.append(Field(word.text, type, written.text, written.span, about, unit, value, spelled, plc=own))
    span = Span(source.path) if name == source.name else Span(source.path, first, 1)
    doc, own = comments.own_of(doc)
    return Message(name, tuple(fields), tuple(constants), span, source.origin, "\n".join(texts), doc, own)


def _declarations(lines: list[Line], name: TypeName, dialect: Dialect, report: Report) -> dict[int, _Declaration]:
    """Line number -> what is declared there."""
    found: dict[int, _Declaration] = {}
    known: dict[str, int] = {}
    for line in lines:
        if report.is_enough(line.path):
            break
        word = ""
        try:
            declaration = _DECLARATION.match(line.text)
            if declaration is None:
                if line.text.strip(" \t") and not line.text.lstrip(" \t").startswith("#"):
                    raise Token(line, 0, line.text).wrong("SHM003", "expected a type and a name")
                continue
            word = declaration["name"] or ""
            found[line.number] = _declaration(line, declaration, name.package, dialect)
            if known.setdefault(word, line.number) != line.number:
                again = f"{shown(word)} is already declared in line {known[word]}"
                raise found[line.number].name.wrong("SHM201", again, "give one of them another name")
        except Wrong as wrong:
            path = f"{name.short}.{word}" if _WORD.fullmatch(word) else ""
            report.error(wrong.code, wrong.message, wrong.span, field=path, hint=habits.hint(line.text) or wrong.hint)
    return found


def _declaration(line: Line, match: re.Match[str], package: str, dialect: Dialect) -> _Declaration:
    written = Token(line, match.start("type"), match["type"])
    if written.text.startswith("@"):
        raise written.wrong("SHM003", "annotations are not supported", "an optional field has no fixed place")
    if match["name"] is None:
        raise written.wrong("SHM003", f"expected a type and a name, found only {shown(written.text)}")
    name = Token(line, match.start("name"), match["name"])
    rest = Token(line, match.start("rest"), match["rest"].rstrip(" \t"))
    is_constant = rest.text.startswith("=")
    type = read_type(written, package, dialect)
    _check_name(name, is_constant, dialect)
    value: Default | None = None
    if is_constant:
        _check_constant(written, type)
        value, rest = read_constant(rest.part(1), type, dialect)
    elif rest.text and not rest.text.startswith("#"):
        if dialect == "ros1":
            raise rest.wrong("SHM003", "ROS 1 has no defaults", f"a constant is written `{written.text} NAME=value`")
        value, rest = read_default(rest, type)
    if rest.text and not rest.text.startswith("#"):
        raise rest.wrong("SHM003", f"{shown(rest.text)} is left over", "a comment begins with `#`")
    return _Declaration(written, name, type, value, is_constant, rest.text)


def _check_name(name: Token, is_constant: bool, dialect: Dialect) -> None:
    kind, patterns = ("constant", _CONSTANT_NAME) if is_constant else ("field", _FIELD_NAME)
    if patterns[dialect].fullmatch(name.text):
        return
    rule = "letters, digits and underscores, a letter first"
    if dialect == "ros2":
        letters = "capitals" if is_constant else "small letters"
        rule = f"{letters}, digits and single underscores, a letter first and no underscore last"
    hint = f"ROS {dialect[-1]} asks for {rule}"
    if "[" in name.text:
        hint = "the brackets belong to the type, without a blank: `T[N] name`"
    elif is_constant and _LOWER.fullmatch(name.text):
        hint += "\na default is written without `=`"
    elif dialect == "ros2" and _WORD.fullmatch(name.text):
        hint += '\nif this is a ROS 1 definition, set source = "noetic"'
    raise name.wrong("SHM202", f"{shown(name.text)} is not a {kind} name", hint)


def _check_constant(written: Token, type: FieldType) -> None:
    if not isinstance(type, Scalar | String) or "<=" in written.text:
        raise written.wrong("SHM006", f"no constant is of type {shown(written.text)}", "use a number, bool or string")
