"""Read definitions with the reference implementations, and return results that are comparable with shmgen's.

rosidl_adapter, rosidl_parser and genmsg are Debian packages, which only Debian's Python can import. A single process
per package reads all definitions. rosbags is a package of PyPI, which this module imports.
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

FOLDER = Path(__file__).parent
ENDINGS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
"""The suffixes of the messages in a file, by the kind of the file."""


class Definition(NamedTuple):
    """One file. The text is the content of the file, opened as text in UTF-8."""

    package: str
    kind: str
    name: str
    text: str


class FieldInfo(NamedTuple):
    """`type` is the full type in ROS 2: `string<=10[<=5]`, `geometry_msgs/msg/Pose`, or `uint8` for byte and char."""

    name: str
    type: str
    default: Any = None
    unit: str = ""


class ConstantInfo(NamedTuple):
    name: str
    type: str
    value: Any


class MessageInfo(NamedTuple):
    """One message."""

    name: str
    fields: tuple[FieldInfo, ...]
    constants: tuple[ConstantInfo, ...]


class Refusal(NamedTuple):
    """An exception that describes the problem. `crashed` is true for an accidental exception of Python."""

    exception: str
    crashed: bool


Answer = tuple[MessageInfo, ...] | Refusal

DELIBERATE_ERRORS = {
    "InvalidSpecification",
    "InvalidValue",
    "InvalidMsgSpec",
    "TypesysError",
    "TypeError",
    "NameError",
    "ValueError",
}
"""rosidl_adapter raises the last three deliberately."""


def from_shmgen(message: Message) -> MessageInfo:
    fields = (FieldInfo(it.name, spell_type(it.type), as_list(it.default), it.unit) for it in message.fields)
    constants = (ConstantInfo(it.name, ros_type(it.type), it.value) for it in message.constants)
    return MessageInfo(str(message.name), tuple(fields), tuple(constants))


def spell_type(type_: FieldType) -> str:
    match type_:
        case Clock():
            return f"builtin_interfaces/msg/{type_.value.capitalize()}"
        case Ref(name):
            return str(name)
        case Array(element, length):
            return f"{spell_type(element)}[{length}]"
        case SequenceType(element, capacity):
            return f"{spell_type(element)}[{'' if capacity is None else f'<={capacity}'}]"
    return ros_type(type_)


def without_defaults(message: MessageInfo) -> MessageInfo:
    """Remove defaults and units, which rosbags and genmsg do not return."""
    return message._replace(fields=tuple(FieldInfo(field.name, field.type) for field in message.fields))


def as_list(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def run_rosidl_adapter(definitions: Sequence[Definition]) -> list[Answer]:
    return _run_script("by_rosidl.py", "adapter", definitions, "ros2")


def run_rosidl_parser(definitions: Sequence[Definition], comments: bool = True) -> list[Answer]:
    """Parse the .idl that rosidl_adapter generates. Without comments, this takes a third of the time."""
    return _run_script("by_rosidl.py", "parser" if comments else "parser-without-comments", definitions, "ros2")


def run_genmsg(definitions: Sequence[Definition]) -> list[Answer]:
    return _run_script("by_genmsg.py", "", definitions, "ros1")


def run_rosbags(definitions: Sequence[Definition], texts: Sequence[Sequence[str]], dialect: Dialect) -> list[Answer]:
    """Read `texts`, the parts of each definition, as messages, because rosbags reads no .srv and no .action."""
    return [_run_rosbags(*pair, dialect) for pair in zip(definitions, texts, strict=True)]


def from_rosbags(name: str, entry: Any, dialect: Dialect) -> MessageInfo:
    """Convert one message of rosbags, which returns no defaults."""
    constants, fields = entry
    return MessageInfo(
        name,
        tuple(FieldInfo(field, spell(_node(type_), dialect)) for field, type_ in fields if field != _FILLER),
        tuple(ConstantInfo(constant, spell(type_, dialect), value) for constant, type_, value in constants),
    )


def _run_rosbags(definition: Definition, texts: Sequence[str], dialect: Dialect) -> Answer:
    messages = []
    for text, ending in zip(texts, ENDINGS[definition.kind], strict=True):
        name = f"{definition.name}{ending}"
        as_message = f"{definition.package}/msg/{name}"
        try:
            entry = get_types_from_msg(text, as_message)[as_message]
        except Exception as error:
            return _rejection([class_.__name__ for class_ in type(error).__mro__])
        messages.append(from_rosbags(f"{definition.package}/{definition.kind}/{name}", entry, dialect))
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


def spell(type_: str, dialect: Dialect) -> str:
    """Convert the type name of a reference to shmgen's spelling."""
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


def _run_script(script: str, argument: str, definitions: Sequence[Definition], dialect: Dialect) -> list[Answer]:
    python = interpreter(script)
    assert python, f"no Python can run {script}"
    done = subprocess.run(
        [python, str(FOLDER / script), argument],
        input=json.dumps(definitions),
        capture_output=True,
        text=True,
        check=True,
        env=_env(),
    )
    return [_parse_answer(answer, dialect) for answer in json.loads(done.stdout)]


def _parse_answer(answer: list[Any], dialect: Dialect) -> Answer:
    if isinstance(answer[0], str):
        return _rejection(answer)
    return tuple(
        MessageInfo(
            name,
            tuple(FieldInfo(field, spell(type_, dialect), default, unit) for field, type_, default, unit in fields),
            tuple(ConstantInfo(constant, spell(type_, dialect), value) for constant, type_, value in constants),
        )
        for name, fields, constants in answer
    )


def _rejection(classes: list[str]) -> Refusal:
    is_deliberate = not DELIBERATE_ERRORS.isdisjoint(classes) and "UnicodeError" not in classes
    return Refusal(classes[0], not is_deliberate)


@functools.cache
def find_versions() -> dict[str, str]:
    """Return the versions of the installed references."""
    versions = {"rosbags": metadata.version("rosbags")}
    for script, packages in {"by_rosidl.py": ("rosidl_adapter", "rosidl_parser"), "by_genmsg.py": ("genmsg",)}.items():
        if python := interpreter(script):
            code = f"from importlib.metadata import version; print(*map(version, {packages!r}))"
            done = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True, env=_env())
            versions |= dict(zip(packages, done.stdout.split(), strict=True))
    return versions


def _env() -> dict[str, str]:
    """Return the environment without variables of Python, because the script runs in another Python."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


@functools.cache
def interpreter(script: str) -> str | None:
    """Return a Python that can import the packages of `script`, usually Debian's, or None."""
    module = {"by_rosidl.py": "rosidl_parser.parser, rosidl_adapter.resource", "by_genmsg.py": "genmsg"}[script]
    for python in (sys.executable, "/usr/bin/python3"):
        done = subprocess.run([python, "-c", f"import {module}"], capture_output=True, check=False, env=_env())
        if done.returncode == 0:
            return python
    return None
