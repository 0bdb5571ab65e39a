"""Parse the text of a .msg, .srv or .action file into Messages with the position of every word.

Each line has one declaration, as in rosidl_adapter (ROS 2) and genmsg (ROS 1). docs/grammar.md describes this parser's
behavior for files on which rosidl_adapter and genmsg differ or crash.
"""

from __future__ import annotations

import re
from typing import TypeAlias

from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Constant, Default, Field, FieldType, Message, Scalar, String, TypeName
from shmgen.core.plural import counted
from shmgen.definitions import comments, syntax_hints
from shmgen.definitions.catalogue import SECTIONS, Definition
from shmgen.definitions.fieldtypes import read_type, type_word
from shmgen.definitions.literals import read_constant, read_default
from shmgen.definitions.tokens import DefinitionError, Dialect, Line, Token, quote


def parse(definition: Definition, text: str, dialect: Dialect, report: Report) -> tuple[Message, ...]:
    """Return the messages of a definition: one for a .msg file, two for a .srv file, three for an .action file.

    Return an empty tuple if the file is not usable. Errors go to the report, at most 20 for a file: SHM003, SHM005,
    SHM006, SHM102, SHM201, SHM202, SHM302.
    """
    lines = lines_of(text, definition.path, report)
    if not lines:
        return ()
    name = definition.name
    if not _MESSAGE_NAME[dialect].fullmatch(name.name):
        hint = "name the file in CamelCase: a capital first, then letters and digits"
        report.error("SHM202", f"{quote(name.name)} is not a message name", Span(definition.path), hint=hint)
        return ()
    endings = SECTIONS[name.kind]
    breaks = [index for index, line in enumerate(lines) if _SEPARATOR.fullmatch(line.text)]
    if len(breaks) != len(endings) - 1:
        culprit = lines[breaks[len(endings) - 1]].span(0, 3) if len(breaks) >= len(endings) else lines[-1].span()
        message = f"a .{name.kind} file has {counted(len(endings), 'part')}, but this file has {len(breaks) + 1}"
        hint = (
            "separate the parts by a line `---`"
            if endings[1:]
            else "write a service to a .srv file in srv/, and an action to an .action file in action/"
        )
        report.error("SHM003", message, culprit, hint=hint)
        return ()
    starts, ends = [0, *(index + 1 for index in breaks)], [*breaks, len(lines)]
    return tuple(
        _message(lines[start:end], name.part(ending), definition, dialect, report)
        for start, end, ending in zip(starts, ends, endings, strict=True)
    )


def lines_of(text: str, path: str, report: Report) -> list[Line]:
    """Split the text into lines. If the text contains a control character, report SHM003 and return an empty list."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = [Line(path, number, line) for number, line in enumerate(text.split("\n"), 1)]
    for line in lines if _CONTROL.search(text) else ():
        if control := _CONTROL.search(line.text):
            code = f"U+{ord(control[0]):04X}"
            report.error("SHM003", f"control character {code}", line.span(control.start(), 1), hint="remove it")
            return []
    return lines


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")
_SEPARATOR = re.compile(r"---+[ \t]*(?:#.*)?")
_DECLARATION = re.compile(r"[ \t]*(?P<type>[^ \t#=][^ \t#]*)(?:[ \t]+(?P<name>[^ \t#=]+))?[ \t]*(?P<rest>.*)")
# The patterns of rosidl_adapter/parser.py and genmsg/names.py, rewritten to prevent backtracking.
_LOWER = re.compile(r"[a-z](?:_?[a-z0-9])*")
_UPPER = re.compile(r"[A-Z](?:_?[A-Z0-9])*")
_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_FIELD_NAME = {"ros1": _WORD, "ros2": _LOWER}
_CONSTANT_NAME = {"ros1": _WORD, "ros2": _UPPER}
_MESSAGE_NAME = {"ros1": _WORD, "ros2": re.compile(r"[A-Z][A-Za-z0-9]*")}


_Declared: TypeAlias = tuple[Field | Constant, str]
"""A field or a constant without its documentation, and the comment after the declaration."""


def _message(lines: list[Line], name: TypeName, definition: Definition, dialect: Dialect, report: Report) -> Message:
    declarations = _declarations(lines, name, dialect, report)
    texts = [line.text for line in lines]
    first = lines[0].number if lines else 0
    doc, docs = comments.assign(texts, {number - first: comment for number, (_, comment) in declarations.items()})
    fields: list[Field] = []
    constants: list[Constant] = []
    for number, (declared, _) in declarations.items():
        about, own = comments.split_plc_note(docs[number - first])
        if isinstance(declared, Constant):
            constants.append(declared._replace(doc=about, plc=own.name))
        else:
            about, unit = comments.split_unit(about)
            fields.append(declared._replace(doc=about, unit=unit, plc=own.name, align=own.align))
    span = Span(definition.path) if name == definition.name else Span(definition.path, first, 1)
    doc, own = comments.split_plc_note(doc)
    text = "\n".join(texts)
    return Message(name, tuple(fields), tuple(constants), span, definition.origin, text, doc, own.name, own.pack)


def _declarations(lines: list[Line], name: TypeName, dialect: Dialect, report: Report) -> dict[int, _Declared]:
    """Map the number of each line that declares a field or a constant to the declaration."""
    declarations: dict[int, _Declared] = {}
    known: dict[str, int] = {}
    for line in lines:
        if report.is_enough(line.path):
            break
        word = ""
        try:
            declaration = _DECLARATION.match(line.text)
            if declaration is None:
                if line.text.strip(" \t") and not line.text.lstrip(" \t").startswith("#"):
                    raise Token(line, 0, line.text).error("SHM003", "expected a type and a name")
                continue
            word = declaration["name"] or ""
            declarations[line.number] = _declaration(line, declaration, name.package, dialect)
            if known.setdefault(word, line.number) != line.number:
                again = f"{quote(word)} is already declared in line {known[word]}"
                raise Token(line, declaration.start("name"), word).error("SHM201", again, "rename one of them")
        except DefinitionError as error:
            path = f"{name.short}.{word}" if _WORD.fullmatch(word) else ""
            report.error(
                error.code, error.message, error.span, field=path, hint=syntax_hints.hint(line.text) or error.hint
            )
    return declarations


def _declaration(line: Line, match: re.Match[str], package: str, dialect: Dialect) -> _Declared:
    written = Token(line, match.start("type"), match["type"])
    if written.text.startswith("@"):
        raise written.error(
            "SHM003", "annotations are not supported", "remove the annotation: an optional field has no fixed offset"
        )
    if match["name"] is None:
        raise written.error("SHM003", f"expected a type and a name, found only {quote(written.text)}")
    name = Token(line, match.start("name"), match["name"])
    rest = Token(line, match.start("rest"), match["rest"].rstrip(" \t"))
    is_constant = rest.text.startswith("=")
    type = read_type(written, package, dialect)
    _check_name(name, is_constant, dialect)
    declared: Field | Constant
    if is_constant:
        constant_type = _constant_type(written, type)
        value, rest = read_constant(rest.part(1), constant_type, dialect)
        declared = Constant(name.text, constant_type, value, name.span)
    else:
        default: Default | None = None
        if rest.text and not rest.text.startswith("#"):
            if dialect == "ros1":
                raise rest.error("SHM003", "ROS 1 has no defaults", f"write a constant as `{written.text} NAME=value`")
            default, rest = read_default(rest, type)
        word = "byte" if type_word(written.text) == "byte" else ""  # ROS 2 reads `char` in a .msg as uint8
        declared = Field(name.text, type, written.text, written.span, default=default, word=word)
    if rest.text and not rest.text.startswith("#"):
        raise rest.error("SHM003", f"unexpected {quote(rest.text)} after the declaration", "begin a comment with `#`")
    return declared, rest.text


def _check_name(name: Token, is_constant: bool, dialect: Dialect) -> None:
    kind, patterns = ("constant", _CONSTANT_NAME) if is_constant else ("field", _FIELD_NAME)
    if patterns[dialect].fullmatch(name.text):
        return
    rule = "letters, digits and underscores, with a letter first"
    if dialect == "ros2":
        letters = "capitals" if is_constant else "small letters"
        rule = f"{letters}, digits and single underscores, with a letter first and no underscore last"
    hint = f"use {rule} (ROS {dialect[-1]})"
    if "[" in name.text:
        hint = "write the brackets directly after the type: `T[N] name`"
    elif is_constant and _LOWER.fullmatch(name.text):
        hint += "\nwrite a default without `=`"
    elif dialect == "ros2" and _WORD.fullmatch(name.text):
        hint += '\nif this is a ROS 1 definition, set source = "noetic"'
    raise name.error("SHM202", f"{quote(name.text)} is not a {kind} name", hint)


def _constant_type(written: Token, type: FieldType) -> Scalar | String:
    """Return the type of a constant. Raises DefinitionError (SHM006) if a constant cannot have this type."""
    if isinstance(type, Scalar | String) and "<=" not in written.text:
        return type
    reason = f"a constant cannot have the type {quote(written.text)}"
    raise written.error("SHM006", reason, "use a number, bool or string")
