"""Turns the generated Structured Text into PLCopen XML for *Project > Import PLCopenXML*, and a script that imports it.

The format is the TC6 XML 2.0 that exports of CODESYS hold, with what CODESYS writes into `addData`; the shape of what
is here is held to records of such exports (tests/targets/codesys_exports.toml). CODESYS prefers a declaration in plain
text (`interfaceasplaintext`) to the structured one: only that keeps comments, pragmas and the base type of an
enumeration. Both are here: the structured one is what the target st planned, the text is what it printed.
"""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.targets import Job, RenderedFile
from shmgen.targets.st import objects, reader
from shmgen.targets.st.names import PRG_TOPICS

NAMES = None
"""All are those that the target st made."""

LIBRARIES = (
    ("SysShm", "SysShm", True),
    ("SysSemProcess", "SysSemProcess", True),
    ("SysTypes2 Interfaces", "SysTypes", False),
)
"""Title and namespace of the libraries that FB_ShmRegion uses, and whether exports name them by a placeholder."""
FOLDER = "ROS"
"""The folder of the application that holds them all; below it one for each package, as below `st/`."""
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
    """Of a unit; `tag` is inputVars and so on. Data types and lists have one, without a tag, for their variables."""

    tag: str
    is_constant: bool
    variables: tuple[Variable, ...]


class Attribute(NamedTuple):
    name: str
    value: str


class Head(NamedTuple):
    """What all objects have; `text` is the declaration in Structured Text. The `id` is what folders name them by."""

    name: str
    id: str
    comment: str
    attributes: tuple[Attribute, ...]
    text: str

    @property
    def has_attributes(self) -> bool:
        return bool(self.attributes)


class DataType(NamedTuple):
    """A structure, an enumeration over the type `base` with its `values`, or another name for `base`."""

    head: Head
    sections: tuple[Section, ...]
    values: tuple[Variable, ...]
    is_enum: bool
    base: str
    initial: str
    is_alias: bool
    methods: tuple[()] = ()


class GlobalList(NamedTuple):
    """A list of global variables or constants."""

    head: Head
    is_constant: bool
    sections: tuple[Section, ...]
    methods: tuple[()] = ()


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
    """`name` as the library manager shows it, `title` without version and company, `resolution` with them."""

    name: str
    title: str
    namespace: str
    resolution: str
    is_placeholder: bool


class Folder(NamedTuple):
    """A folder of the IDE: that of a package."""

    name: str
    objects: tuple[DataType | GlobalList | Unit, ...]


class Project(NamedTuple):
    """The XML file and the script; the interval in seconds for PLCopen, in milliseconds for CODESYS.

    `folders` and the objects of the `loose` one lie in `folder`; each is in `data_types`, `lists` or `units` too.
    """

    data_types: tuple[DataType, ...]
    lists: tuple[GlobalList, ...]
    units: tuple[Unit, ...]
    folders: tuple[Folder, ...]
    loose: tuple[Folder, ...]
    libraries: tuple[Library, ...]
    has_task: bool
    seconds: str
    milliseconds: str
    task: str = TASK
    priority: str = PRIORITY
    program: str = PRG_TOPICS
    folder: str = FOLDER


def plan(job: Job, report: Report) -> Iterator[Output]:
    """`plcopen/` of what the target st planned and printed, and of the interval of the task."""
    folders: dict[str, list[DataType | GlobalList | Unit]] = {}
    for printed in sorted(job.printed["st"], key=lambda printed: printed.output.path):
        _, *below, _ = printed.output.path.split("/")
        folders.setdefault("/".join(below), []).append(_stored(stored_object(printed), printed.text.rstrip("\n")))
    loose = tuple(folders.pop("", ()))
    found = [*(one for objects in folders.values() for one in objects), *loose]
    interval = job.options.task_interval
    view = Project(
        data_types=tuple(one for one in found if isinstance(one, DataType)),
        lists=tuple(one for one in found if isinstance(one, GlobalList)),
        units=tuple(one for one in found if isinstance(one, Unit)),
        folders=tuple(Folder(name, tuple(objects)) for name, objects in folders.items()),
        loose=(Folder("", loose),) if loose else (),
        libraries=tuple(_libraries()),
        has_task=any(one.head.name == PRG_TOPICS for one in loose),
        seconds=f"{interval / 1000:f}".rstrip("0").rstrip("."),
        milliseconds=str(interval),
    )
    yield Output("plcopen/shmgen.xml", "plcopen/project.xml.j2", view)
    yield Output("plcopen/import_shmgen.py", "plcopen/import_shmgen.py.j2", view)


def _libraries() -> Iterator[Library]:
    for title, namespace, is_placeholder in LIBRARIES:
        resolution = f"{title}, * (System)"
        yield Library(f"#{title}" if is_placeholder else resolution, title, namespace, resolution, is_placeholder)


def stored_object(printed: RenderedFile) -> objects.DataType | objects.GlobalList | objects.Unit:
    """As it was planned. The text of blocks, which is written by hand in the templates, is cut as an IDE stores it."""
    match printed.output.view:
        case objects.Dut() | objects.Gvl() as view:
            return view.object
        case _:
            return reader.read(printed.output.path.rpartition("/")[2].removesuffix(".st"), printed.text)


def _stored(found: objects.DataType | objects.GlobalList | objects.Unit, text: str) -> DataType | GlobalList | Unit:
    match found:
        case objects.DataType():
            return _data_type(found, text)
        case objects.GlobalList():
            return _list(found, text)
        case _:
            return _unit(found)


def _data_type(found: objects.DataType, text: str) -> DataType:
    members = _variables(found.members)
    return DataType(
        _head(found.name, found.head, text),
        (Section("", False, members),),
        members,
        is_enum=bool(found.base),
        base=_type(found.base or found.alias) if found.base or found.alias else "",
        initial=_text(found.initial),
        is_alias=bool(found.alias),
    )


def _list(found: objects.GlobalList, text: str) -> GlobalList:
    is_constant = found.variables.constant
    section = Section("", is_constant, _variables(found.variables.variables))
    return GlobalList(_head(found.name, found.head, text), is_constant, (section,))


_KINDS = {"FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program", "METHOD": ""}
_TAGS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}


def _unit(found: objects.Unit, within: str = "") -> Unit:
    sections = [
        Section(_TAGS[section.keyword], section.constant, _variables(section.variables)) for section in found.sections
    ]
    return Unit(
        _head(found.name, found.head, found.declaration, within),
        kind=_KINDS[found.keyword],
        is_private=found.access == "PRIVATE",
        has_return=bool(found.returns),
        returns=_type(found.returns) if found.returns else "",
        sections=tuple(sections),
        body=_text(found.body),
        methods=tuple(_unit(method, f"{found.name}.") for method in found.methods),
    )


_OURS = bytes.fromhex("6a9c1f0e5d3b5f639c557e1f6d2b8a40")
"""Drawn once. An object's id is made of this and of its name, so that it is the same each time."""


def _head(name: str, head: objects.Head, text: str, within: str = "") -> Head:
    attributes = tuple(Attribute(_text(found.name), _text(found.value)) for found in head.attributes)
    return Head(name, _id(within + name), _text("\n".join(head.comment)), attributes, _text(text))


def _id(name: str) -> str:
    """As `uuid.uuid5` makes it (RFC 9562, 5.5); that module takes long to load."""
    made = int.from_bytes(hashlib.sha1(_OURS + name.encode(), usedforsecurity=False).digest()[:16], "big")
    digits = f"{made & ~(0xF << 76) & ~(3 << 62) | 5 << 76 | 2 << 62:032x}"
    return "-".join((digits[:8], digits[8:12], digits[12:16], digits[16:20], digits[20:]))


def _variables(found: Iterable[objects.Variable]) -> tuple[Variable, ...]:
    return tuple(map(_variable, found))


@functools.lru_cache(4096)  # most stand in many blocks
def _variable(found: objects.Variable) -> Variable:
    return Variable(
        found.name,
        _type(found.type) if found.type else "",
        bool(found.value),
        _value(found.value),
        _text(found.value) if isinstance(found.value, str) else "",
        bool(found.comment),
        _text(found.comment),
    )


_ELEMENTARY = re.compile("BOOL|BYTE|[DL]?WORD|U?[SDL]?INT|L?REAL|TIME|DATE|TOD|DT")
"""Those with an element of their own in TC6 2.01; LTIME and CODESYS's own are `derived`."""
_STRING = re.compile(r"(W?STRING)\((\d+)\)")
_ARRAY = re.compile(r"ARRAY\[([-\d., ]+)\] OF (.+)")


@functools.cache
def _type(spelled: str) -> str:
    """`ARRAY[0..2] OF LREAL` as PLCopen spells it."""
    if array := _ARRAY.fullmatch(spelled):
        bounds = (dimension.strip().partition("..") for dimension in array[1].split(","))
        dimensions = "".join(f'<dimension lower="{lower}" upper="{upper}" />' for lower, _, upper in bounds)
        return f"<array>{dimensions}<baseType>{_type(array[2])}</baseType></array>"
    if spelled.startswith("POINTER TO "):
        return f"<pointer><baseType>{_type(spelled.removeprefix('POINTER TO '))}</baseType></pointer>"
    if string := _STRING.fullmatch(spelled):
        return f'<{string[1].lower()} length="{string[2]}" />'
    if _ELEMENTARY.fullmatch(spelled):
        return f"<{spelled} />"
    assert re.fullmatch(r"[\w.]+", spelled), f"not a type: {spelled}"
    return f'<derived name="{spelled}" />'


def _value(spelled: str | tuple[str, ...]) -> str:
    """`1.0`, or the elements of an array, as PLCopen spells them."""
    if isinstance(spelled, str):
        return f'<simpleValue value="{_text(spelled)}" />'
    return f"<arrayValue>{''.join(f'<value>{_value(element)}</value>' for element in spelled)}</arrayValue>"


@functools.lru_cache(4096)  # most names and comments are those of many blocks
def _text(text: str) -> str:
    """For an element or an attribute. XML 1.0 has no way to write most control characters; Structured Text has none."""
    assert text.isascii(), "generated Structured Text is ASCII"
    assert text.replace("\n", "").isprintable(), "and has no control characters"
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")
