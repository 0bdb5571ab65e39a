"""Turns the generated Structured Text into PLCopen XML for *Project > Import PLCopenXML*, and a script that imports it.

The format is TC6 XML 2.01 with what CODESYS writes into `addData`. CODESYS prefers a declaration in plain text
(`interfaceasplaintext`) to the structured one: only that keeps comments, pragmas and the base type of an enumeration.
Both are here, and both are read from the text of the .st file, so there is one source for all.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import PurePosixPath
from typing import NamedTuple

from shmgen.model import Output
from shmgen.targets import naming
from shmgen.targets.plcopen import source

LIBRARIES = (("SysShm", "SysShm"), ("SysSemProcess", "SysSemProcess"), ("SysTypes Interfaces", "SysTypes"))
"""Title and namespace of the libraries that FB_ShmRegion uses."""
TASK = "RosTask"
PRIORITY = "10"
"""0 is the highest of CODESYS, 31 the lowest; a new project's own task has 1, and control goes before talk."""


class Variable(NamedTuple):
    """`type` and `value` are pieces of XML, as PLCopen spells types and values; `number` that of an enumeration."""

    name: str
    type: str
    has_value: bool
    value: str
    number: str
    has_comment: bool
    comment: str


class Section(NamedTuple):
    """`tag` is inputVars and so on."""

    tag: str
    constant: str
    variables: tuple[Variable, ...]


class Attribute(NamedTuple):
    name: str
    value: str


class Head(NamedTuple):
    """What all objects have; `text` is the declaration in Structured Text."""

    name: str
    comment: str
    attributes: tuple[Attribute, ...]
    text: str


class DataType(NamedTuple):
    """A structure, or an enumeration over the type `base`."""

    head: Head
    members: tuple[Variable, ...]
    is_enum: bool
    base: str
    initial: str


class GlobalList(NamedTuple):
    """A list of global variables or constants."""

    head: Head
    constant: str
    variables: tuple[Variable, ...]


class Unit(NamedTuple):
    """A block, a program, or a method, which has no `kind` and no methods."""

    head: Head
    kind: str
    is_private: bool
    has_return: bool
    returns: str
    sections: tuple[Section, ...]
    body: str
    methods: tuple[Unit, ...]


class Library(NamedTuple):
    """`name` as the library manager shows it."""

    name: str
    namespace: str


class Project(NamedTuple):
    """The XML file and the script; the interval in seconds for PLCopen, in milliseconds for CODESYS."""

    data_types: tuple[DataType, ...]
    lists: tuple[GlobalList, ...]
    units: tuple[Unit, ...]
    libraries: tuple[Library, ...]
    has_task: bool
    seconds: str
    milliseconds: str
    task: str = TASK
    priority: str = PRIORITY
    program: str = naming.PRG_TOPICS


def plan(sources: Mapping[str, str], interval: int) -> Iterator[Output]:
    """`plcopen/` of the texts that the target st wrote, by path; `interval` of the task in milliseconds."""
    objects = [source.read(PurePosixPath(path).stem, text) for path, text in sources.items()]
    view = Project(
        data_types=tuple(_data_type(found) for found in objects if isinstance(found, source.DataType)),
        lists=tuple(_list(found) for found in objects if isinstance(found, source.GlobalList)),
        units=tuple(_unit(found) for found in objects if isinstance(found, source.Unit)),
        libraries=tuple(Library(f"{title}, * (System)", namespace) for title, namespace in LIBRARIES),
        has_task=any(found.name == naming.PRG_TOPICS for found in objects),
        seconds=f"{interval / 1000:f}".rstrip("0").rstrip("."),
        milliseconds=str(interval),
    )
    yield Output("plcopen/shmgen.xml", "plcopen/project.xml.j2", view)
    yield Output("plcopen/import_shmgen.py", "plcopen/import_shmgen.py.j2", view)


def _data_type(found: source.DataType) -> DataType:
    return DataType(
        _head(found.name, found.head, found.text),
        _variables(found.members),
        is_enum=bool(found.base),
        base=_type(found.base) if found.base else "",
        initial=_text(found.initial),
    )


def _list(found: source.GlobalList) -> GlobalList:
    section = found.variables
    return GlobalList(_head(found.name, found.head, found.text), _bool(section.constant), _variables(section.variables))


_KINDS = {"FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program", "METHOD": ""}
_TAGS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}


def _unit(found: source.Unit) -> Unit:
    sections = [
        Section(_TAGS[section.keyword], _bool(section.constant), _variables(section.variables))
        for section in found.sections
    ]
    return Unit(
        _head(found.name, found.head, found.declaration),
        kind=_KINDS[found.keyword],
        is_private=found.access == "PRIVATE",
        has_return=bool(found.returns),
        returns=_type(found.returns) if found.returns else "",
        sections=tuple(sections),
        body=_text(found.body),
        methods=tuple(_unit(method) for method in found.methods),
    )


def _head(name: str, head: source.Head, text: str) -> Head:
    attributes = tuple(Attribute(_text(key), _text(value)) for key, value in head.attributes)
    return Head(name, _text(head.comment), attributes, _text(text))


def _variables(found: Iterable[source.Variable]) -> tuple[Variable, ...]:
    return tuple(
        Variable(
            variable.name,
            _type(variable.type) if variable.type else "",
            bool(variable.value),
            _value(variable.value),
            _text(variable.value),
            bool(variable.comment),
            _text(variable.comment),
        )
        for variable in found
    )


_ELEMENTARY = re.compile("BOOL|BYTE|[DL]?WORD|U?[SDL]?INT|L?REAL|TIME")
"""Those with an element of their own in TC6 2.01; LTIME and CODESYS's own are `derived`."""
_STRING = re.compile(r"(W?STRING)\((\d+)\)")
_ARRAY = re.compile(r"ARRAY\[(\d+)\.\.(\d+)\] OF (.+)")


def _type(spelled: str) -> str:
    """`ARRAY[0..2] OF LREAL` as PLCopen spells it."""
    if array := _ARRAY.fullmatch(spelled):
        dimension = f'<dimension lower="{array[1]}" upper="{array[2]}" />'
        return f"<array>{dimension}<baseType>{_type(array[3])}</baseType></array>"
    if spelled.startswith("POINTER TO "):
        return f"<pointer><baseType>{_type(spelled.removeprefix('POINTER TO '))}</baseType></pointer>"
    if string := _STRING.fullmatch(spelled):
        return f'<{string[1].lower()} length="{string[2]}" />'
    if _ELEMENTARY.fullmatch(spelled):
        return f"<{spelled} />"
    assert re.fullmatch(r"\w+", spelled), f"not a type: {spelled}"
    return f'<derived name="{spelled}" />'


_ELEMENT = re.compile(rf"(?:{source.STRINGS}|[^,'\"])+")


def _value(spelled: str) -> str:
    """`[1.0, 2.0]` as PLCopen spells it."""
    if not spelled.startswith("["):
        return f'<simpleValue value="{_text(spelled)}" />'
    elements = (found.strip() for found in _ELEMENT.findall(spelled[1:-1]))
    return f"<arrayValue>{''.join(f'<value>{_value(element)}</value>' for element in elements)}</arrayValue>"


def _bool(value: bool) -> str:
    return "true" if value else "false"


def _text(text: str) -> str:
    """For an element or an attribute. XML 1.0 has no way to write most control characters; Structured Text has none."""
    assert text.isascii(), "generated Structured Text is ASCII"
    assert text.replace("\n", "").isprintable(), "and has no control characters"
    return html.escape(text, quote=False).replace('"', "&quot;")
