"""What the reference implementations make of a definition, in words that can be compared with ours.

rosidl_adapter, rosidl_parser and genmsg are Debian packages, and seen by its own Python only: each is run once, as a
process that reads many definitions. rosbags is a package of PyPI, and called.
"""

from __future__ import annotations

import functools
import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg

from shmgen.core.model import Array, Clock, FieldType, Message, Ref, ros_type
from shmgen.core.model import Sequence as SequenceType
from shmgen.definitions.tokens import Dialect

HERE = Path(__file__).parent
ENDINGS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
"""Kind -> the endings of the messages that a user wrote in such a file."""


class Definition(NamedTuple):
    """One file; the text as a program gets it that opened the file as text in UTF-8."""

    package: str
    kind: str
    name: str
    text: str


class FieldRead(NamedTuple):
    """`type` as ROS 2 spells it, in full: `string<=10[<=5]`, `geometry_msgs/msg/Pose`, `uint8` for byte and char."""

    name: str
    type: str
    default: Any = None
    unit: str = ""


class ConstantRead(NamedTuple):
    name: str
    type: str
    value: Any


class Read(NamedTuple):
    """One message."""

    name: str
    fields: tuple[FieldRead, ...]
    constants: tuple[ConstantRead, ...]


class Refused(NamedTuple):
    """By an exception that says what is wrong with the definition; `crashed` if it is one of Python's own mishaps."""

    exception: str
    crashed: bool


Answer = tuple[Read, ...] | Refused

REFUSALS = {
    "InvalidSpecification",
    "InvalidValue",
    "InvalidMsgSpec",
    "TypesysError",
    "TypeError",
    "NameError",
    "ValueError",
}
"""rosidl_adapter raises the last three on purpose."""


def ours(message: Message) -> Read:
    fields = (FieldRead(field.name, spelled(field.type), listed(field.default), field.unit) for field in message.fields)
    constants = (ConstantRead(constant.name, ros_type(constant.type), constant.value) for constant in message.constants)
    return Read(str(message.name), tuple(fields), tuple(constants))


def spelled(type_: FieldType) -> str:
    match type_:
        case Clock():
            return f"builtin_interfaces/msg/{type_.value.capitalize()}"
        case Ref(name):
            return str(name)
        case Array(element, length):
            return f"{spelled(element)}[{length}]"
        case SequenceType(element, capacity):
            return f"{spelled(element)}[{'' if capacity is None else f'<={capacity}'}]"
    return ros_type(type_)


def without_defaults(read: Read) -> Read:
    """And units: what rosbags and genmsg tell."""
    return read._replace(fields=tuple(FieldRead(field.name, field.type) for field in read.fields))


def listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def rosidl_adapter(definitions: Sequence[Definition]) -> list[Answer]:
    return _run("by_rosidl.py", "adapter", definitions, "ros2")


def rosidl_parser(definitions: Sequence[Definition], comments: bool = True) -> list[Answer]:
    """Of the .idl that rosidl_adapter makes of each; without the comments it takes a third of the time."""
    return _run("by_rosidl.py", "parser" if comments else "parser-without-comments", definitions, "ros2")


def genmsg(definitions: Sequence[Definition]) -> list[Answer]:
    return _run("by_genmsg.py", "", definitions, "ros1")


def rosbags(definitions: Sequence[Definition], texts: Sequence[Sequence[str]], dialect: Dialect) -> list[Answer]:
    """It reads no .srv and no .action, so `texts` are those of their parts, each taken for a message."""
    return [_rosbags(*pair, dialect) for pair in zip(definitions, texts, strict=True)]


def of_typesdict(name: str, entry: Any, dialect: Dialect) -> Read:
    """One message of rosbags, which tells no defaults."""
    constants, fields = entry
    return Read(
        name,
        tuple(FieldRead(field, plain(_node(type_), dialect)) for field, type_ in fields if field != _FILLER),
        tuple(ConstantRead(constant, plain(type_, dialect), value) for constant, type_, value in constants),
    )


def _rosbags(definition: Definition, texts: Sequence[str], dialect: Dialect) -> Answer:
    messages = []
    for text, ending in zip(texts, ENDINGS[definition.kind], strict=True):
        name = f"{definition.name}{ending}"
        as_message = f"{definition.package}/msg/{name}"
        try:
            entry = get_types_from_msg(text, as_message)[as_message]
        except Exception as error:
            return _refused([class_.__name__ for class_ in type(error).__mro__])
        messages.append(of_typesdict(f"{definition.package}/{definition.kind}/{name}", entry, dialect))
    return tuple(messages)


_FILLER = "structure_needs_at_least_one_member"


def _node(type_: Any) -> str:
    kind, content = type_[0], type_[1]
    if kind == Nodetype.BASE:
        return f"{content[0]}<={content[1]}" if content[1] else str(content[0])
    if kind == Nodetype.NAME:
        return str(content)
    bound = str(content[1] or "")
    return f"{_node(content[0])}[{'<=' if kind == Nodetype.SEQUENCE and bound else ''}{bound}]"


def plain(type_: str, dialect: Dialect) -> str:
    """A reference's spelling as ours."""
    base = re.match(r"[^<\[]*", type_)
    assert base
    words = {
        "byte": "int8" if dialect == "ros1" else "uint8",
        "char": "uint8",
        "octet": "uint8",
        "time": "builtin_interfaces/msg/Time",
        "duration": "builtin_interfaces/msg/Duration",
    }
    name = words.get(base[0], base[0])
    if name.count("/") == 1:
        name = name.replace("/", "/msg/")
    return name + type_[base.end() :]


def _run(script: str, argument: str, definitions: Sequence[Definition], dialect: Dialect) -> list[Answer]:
    python = interpreter(script)
    assert python, f"no Python here that could run {script}"
    done = subprocess.run(
        [python, str(HERE / script), argument],
        input=json.dumps(definitions),
        capture_output=True,
        text=True,
        check=True,
        env=_clean(),
    )
    return [_answer(answer, dialect) for answer in json.loads(done.stdout)]


def _answer(answer: list[Any], dialect: Dialect) -> Answer:
    if isinstance(answer[0], str):
        return _refused(answer)
    return tuple(
        Read(
            name,
            tuple(FieldRead(field, plain(type_, dialect), default, unit) for field, type_, default, unit in fields),
            tuple(ConstantRead(constant, plain(type_, dialect), value) for constant, type_, value in constants),
        )
        for name, fields, constants in answer
    )


def _refused(classes: list[str]) -> Refused:
    on_purpose = not REFUSALS.isdisjoint(classes) and "UnicodeError" not in classes
    return Refused(classes[0], not on_purpose)


@functools.cache
def versions() -> dict[str, str]:
    """Of those that are here."""
    found = {"rosbags": metadata.version("rosbags")}
    for script, packages in {"by_rosidl.py": ("rosidl_adapter", "rosidl_parser"), "by_genmsg.py": ("genmsg",)}.items():
        if python := interpreter(script):
            ask = f"from importlib.metadata import version; print(*map(version, {packages!r}))"
            done = subprocess.run([python, "-c", ask], capture_output=True, text=True, check=True, env=_clean())
            found |= dict(zip(packages, done.stdout.split(), strict=True))
    return found


def _clean() -> dict[str, str]:
    """The environment without what it says to Python: theirs is another one."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


@functools.cache
def interpreter(script: str) -> str | None:
    """A Python that has the packages `script` imports: Debian's, mostly."""
    module = {"by_rosidl.py": "rosidl_parser.parser, rosidl_adapter.resource", "by_genmsg.py": "genmsg"}[script]
    for python in (sys.executable, "/usr/bin/python3"):
        done = subprocess.run([python, "-c", f"import {module}"], capture_output=True, check=False, env=_clean())
        if done.returncode == 0:
            return python
    return None
