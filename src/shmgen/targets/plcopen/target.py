"""Generate PLCopen XML from the Structured Text for *Project > Import PLCopenXML*, and a script that imports it.

The format is TC6 XML 2.0 with the `addData` elements of CODESYS. Tests compare the output with records of
CODESYS exports (tests/targets/codesys_exports.toml). CODESYS prefers a declaration in plain text
(`interfaceasplaintext`) to the structured declaration. Only the plain text keeps comments, pragmas and the base type
of an enumeration. The XML contains both: the structured declaration from the target st's plan, and the text from
the rendered files of st.
"""

from __future__ import annotations

import re
import uuid
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.targets import Job, RenderedFile
from shmgen.targets.st import objects, reader
from shmgen.targets.st.names import PRG_TOPICS
from shmgen.targets.st.text import uncommented

NAMES = None
"""None, because the target st creates and checks all names."""


class Variable(NamedTuple):
    """The template data for a variable or for a name of an enumeration.

    `type` and `value` are PLCopen XML. `number` is the value of a name of an enumeration.
    """

    name: str
    type: str
    value: str
    number: str
    comment: str


class Section(NamedTuple):
    """A group of variables of one kind in a unit. `tag` is the XML tag of the kind, such as inputVars."""

    tag: str
    is_constant: bool
    variables: tuple[Variable, ...]


class Head(NamedTuple):
    """The data that data types, lists and units have in common.

    `text` is the declaration in Structured Text. A folder refers to an object by its `id`.
    """

    name: str
    id: str
    comment: str
    attributes: tuple[objects.Attribute, ...]
    text: str


class DataType(NamedTuple):
    """The template data for a data type: a structure, an enumeration over the type `base`, or an alias of `alias`.

    `members` are the members of a structure, or the names and numbers of an enumeration.
    """

    head: Head
    members: tuple[Variable, ...]
    base: str
    alias: str
    initial: str
    methods: tuple[()] = ()


class GlobalList(NamedTuple):
    """A list of global variables or constants."""

    head: Head
    is_constant: bool
    variables: tuple[Variable, ...]
    methods: tuple[()] = ()


class Unit(NamedTuple):
    """The template data for a block, a program, or a method. A method has an empty `kind` and no methods."""

    head: Head
    kind: str
    is_private: bool
    returns: str
    sections: tuple[Section, ...]
    body: str
    methods: tuple[Unit, ...]


class Folder(NamedTuple):
    """The objects of one package. The name is `""` for the objects outside the folders of packages."""

    name: str
    objects: tuple[DataType | GlobalList | Unit, ...]


class Project(NamedTuple):
    """The template data for the XML file and the import script.

    * `data_types`, `lists` and `units` together contain all objects, as the XML file groups them.
    * `folders` contains the same objects, as the IDE groups them in the folder `ROS`.
    * `seconds` and `milliseconds` are the interval of the task, for PLCopen and for CODESYS.
    * `library_manager` is the id of the IDE's object with the list of libraries.
    """

    data_types: tuple[DataType, ...]
    lists: tuple[GlobalList, ...]
    units: tuple[Unit, ...]
    folders: tuple[Folder, ...]
    has_task: bool
    seconds: str
    milliseconds: str
    library_manager: str


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield the XML file and the import script in `plcopen/`, from the rendered files of the target st."""
    folders: dict[str, list[DataType | GlobalList | Unit]] = {}
    for file in sorted(job.rendered["st"], key=lambda file: file.output.path):
        _, *below, _ = file.output.path.split("/")
        folders.setdefault("/".join(below), []).append(_convert(stored_object(file), file.text.rstrip("\n")))
    folders[""] = folders.pop("", [])  # the last folder
    all_objects = [one for objects in folders.values() for one in objects]
    interval = job.options.task_interval
    view = Project(
        data_types=tuple(one for one in all_objects if isinstance(one, DataType)),
        lists=tuple(one for one in all_objects if isinstance(one, GlobalList)),
        units=tuple(one for one in all_objects if isinstance(one, Unit)),
        folders=tuple(Folder(name, tuple(objects)) for name, objects in folders.items()),
        has_task=any(one.head.name == PRG_TOPICS for one in all_objects),
        seconds=f"{interval / 1000:f}".rstrip("0").rstrip("."),
        milliseconds=str(interval),
        library_manager=_id("Library Manager"),
    )
    yield Output("plcopen/shmgen.xml", "plcopen/project.xml.j2", view)
    yield Output("plcopen/import_shmgen.py", "plcopen/import_shmgen.py.j2", view)


def stored_object(file: RenderedFile) -> objects.DataType | objects.GlobalList | objects.Unit:
    """Return the Structured Text object that a file of the target st contains.

    The object of a generated data type or list is known from the plan of the file. Any other file is parsed.
    """
    match file.output.view:
        case objects.Dut() | objects.Gvl() as view:
            return view.object
        case _:
            return reader.read(file.output.path.rpartition("/")[2].removesuffix(".st"), file.text)


def _convert(item: objects.DataType | objects.GlobalList | objects.Unit, text: str) -> DataType | GlobalList | Unit:
    match item:
        case objects.DataType():
            return DataType(
                _head(item.name, item.head, text),
                _variables(item.members),
                base=_type(item.base),
                alias=_type(item.alias),
                initial=_text(item.initial),
            )
        case objects.GlobalList(variables=section):
            return GlobalList(_head(item.name, item.head, text), section.constant, _variables(section.variables))
        case _:
            return _unit(item)


_KINDS = {"FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program", "METHOD": ""}
_TAGS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}


def _unit(unit: objects.Unit, within: str = "") -> Unit:
    sections = [
        Section(_TAGS[section.keyword], section.constant, _variables(section.variables)) for section in unit.sections
    ]
    return Unit(
        _head(unit.name, unit.head, unit.declaration, within),
        kind=_KINDS[unit.keyword],
        is_private=unit.access == "PRIVATE",
        returns=_type(unit.returns),
        sections=tuple(sections),
        body=_text(unit.body),
        methods=tuple(_unit(method, f"{unit.name}.") for method in unit.methods),
    )


_OURS = uuid.UUID("6a9c1f0e-5d3b-5f63-9c55-7e1f6d2b8a40")
"""The fixed namespace of ids. An id depends only on this value and the object's name, so each run creates equal ids."""


def _head(name: str, head: objects.Head, text: str, within: str = "") -> Head:
    attributes = tuple(attribute._replace(value=_text(attribute.value)) for attribute in head.attributes)
    return Head(name, _id(within + name), _text(uncommented(head.comment)), attributes, _text(text))


def _id(name: str) -> str:
    """Return a UUID for the object `name`, the same in every run."""
    return str(uuid.uuid5(_OURS, name))


def _variables(variables: Iterable[objects.Variable]) -> tuple[Variable, ...]:
    return tuple(map(_variable, variables))


def _variable(variable: objects.Variable) -> Variable:
    return Variable(
        variable.name,
        _type(variable.type),
        _value(variable.value) if variable.value else "",
        _text(variable.value) if isinstance(variable.value, str) else "",
        _text(uncommented(variable.comment)),
    )


_ELEMENTARY = re.compile("BOOL|BYTE|[DL]?WORD|U?[SDL]?INT|L?REAL|TIME|DATE|TOD|DT")
"""The types with an XML element of their own in TC6 2.01. LTIME and the types of CODESYS are `derived`."""
_STRING = re.compile(r"(W?STRING)\((\d+)\)")
_ARRAY = re.compile(r"ARRAY\[([-\d., ]+)\] OF (.+)")


def _type(spelled: str) -> str:
    """Return a type such as `ARRAY[0..2] OF LREAL` as PLCopen XML, or `""` if there is no type."""
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
    assert re.fullmatch(r"[\w.]*", spelled), f"not a type: {spelled}"
    return f'<derived name="{spelled}" />' if spelled else ""


def _value(spelled: str | tuple[str, ...]) -> str:
    """Return an initial value as PLCopen XML. For an array, `spelled` has the value of each element."""
    if isinstance(spelled, str):
        return f'<simpleValue value="{_text(spelled)}" />'
    return f"<arrayValue>{''.join(f'<value>{_value(element)}</value>' for element in spelled)}</arrayValue>"


def _text(text: str) -> str:
    """Escape text for an XML element or attribute.

    The text must not contain control characters, because XML 1.0 cannot represent most of them. Structured Text has
    none.
    """
    assert text.isascii() or re.sub(r"\w", "", text).isascii(), "only names of an imported project may be non-ASCII"
    assert text.replace("\n", "").isprintable(), "the text must not have control characters"
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")
