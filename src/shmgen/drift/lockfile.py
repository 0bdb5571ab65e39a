"""Write and read layout.lock: the generated files, their definitions and settings."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from shmgen.core import toml
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.core.model import Layout, Layouts, Ref, Role, Slot, ros_type
from shmgen.core.type_hash import hashes

LOCK = "layout.lock"
VERSION = 1
LISTS = ("topics", "services", "actions")
"""Settings that have one line for each item."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A field of a message in layout.lock. `type` is the type of one element, and `offset` is in bytes.

    `count` is the number of elements, or None if the field is not an array. The type of a nested message is its full
    name, such as `demo_msgs/action/Move_Goal`.
    """

    name: str
    type: str
    count: int | None
    offset: int
    is_sequence: bool = False

    @property
    def spelled(self) -> str:
        type_ = short(self.type) if "/" in self.type else self.type
        if self.count is None:
            return type_
        return f"{type_}[{'<=' if self.is_sequence else ''}{self.count}]"


class Block(NamedTuple):
    """A message in layout.lock. `size` is in bytes, and `text` is a hash of the definition.

    `constants` maps names to a type and a value, such as `uint8 1`.
    """

    digest: str
    size: int
    origin: str
    text: str
    fields: Mapping[str, Entry]
    defaults: Mapping[str, str]
    constants: Mapping[str, str]
    units: Mapping[str, str]


class Lock(NamedTuple):
    """The content of layout.lock, the record of a run of `generate`.

    It contains the requested messages, the settings, all messages, and the SHA-256 of each written file.
    """

    requested: tuple[str, ...] = ()
    settings: Mapping[str, Any] = {}
    messages: Mapping[str, Block] = {}
    files: Mapping[str, str] = {}


def write(layouts: Layouts, texts: Mapping[str, str], settings: Mapping[str, object]) -> str:
    """Return the text of layout.lock.

    The order is stable, and each slot has one line. The text has no date, host name or version of shmgen, so that
    the same input gives the same text.
    """
    ordered = [layouts[name] for name in sorted(layouts)]
    lines = [
        "# Record of the last run of `shmgen generate`. Commit this file with the generated files.",
        f"version = {VERSION}",
        *_list("requested", [str(layout.name) for layout in ordered if layout.requested]),
        "",
        "[settings]",
    ]
    for key, value in settings.items():
        lines += _list(key, value) if key in LISTS and isinstance(value, list) else [f"{key} = {_toml(value)}"]
    type_hashes = hashes(layouts, {layout.name: layout.message for layout in ordered})
    for layout in ordered:
        lines += ["", *_block(layout, type_hashes[layout.name])]
    lines += ["", "[files]", *(f"{_toml(path)} = {_toml(sha256(text))}" for path, text in sorted(texts.items()))]
    return "\n".join(lines) + "\n"


def read(text: str, place: str) -> Lock:
    """Parse the text of layout.lock. Raises Rejected (SHM408) if the text is damaged."""
    try:
        return parse(text)
    except (KeyError, TypeError, ValueError, AttributeError):
        what = "layout.lock is damaged, so shmgen cannot determine which files are generated"
        hint = "restore it from version control, or delete it and the generated files, and run `shmgen generate`"
        raise Rejected([Diagnostic("SHM408", what, Span(place), hint=hint)]) from None


def read_requested(text: str, place: str) -> Lock:
    """Parse layout.lock without its messages, because parsing the messages takes long.

    The result contains the requested names, the settings and the files. Raises the error of read().
    """
    head, has_messages, rest = text.partition("\n[messages.")
    listed = rest.partition("\n[files]\n")[2]
    files = dict(_FILE.findall(listed))
    if not has_messages or len(files) < listed.count("\n"):
        return read(text, place)
    return read(f"{head}\n[files]\n", place)._replace(files=files)


def parse(text: str) -> Lock:
    """Parse the text of layout.lock. Raises KeyError, TypeError, ValueError or AttributeError if it is damaged."""
    data = toml.loads(text)
    requested, files = data["requested"], data["files"]
    if data["version"] != VERSION or not all(isinstance(item, str) for item in [*requested, *files.values()]):
        raise ValueError("version")
    blocks = data.get("messages", {})
    messages = {name: _read_block(block, blocks) for name, block in blocks.items()}
    return Lock(tuple(requested), dict(data.get("settings", {})), messages, dict(files))


def short(name: str) -> str:
    """Return the short name of a message: `demo_msgs/msg/Pose` -> `demo_msgs/Pose`."""
    package, _, rest = name.partition("/")
    return f"{package}/{rest.rpartition('/')[2]}"


def sha256(text: str | bytes) -> str:
    return hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()


def _block(layout: Layout, type_hash: str) -> list[str]:
    message = layout.message
    defaults = [f"{field.name} = {_JSON(field.default)}" for field in message.fields if field.default is not None]
    constants = [f"{ros_type(one.type)} {one.name} = {_JSON(one.value)}" for one in message.constants]
    units = [f"{field.name} = {field.unit}" for field in message.fields if field.unit]
    return [
        f"[messages.{_toml(str(layout.name))}]",
        f"digest = {_toml(f'{layout.digest:016x}')}",
        f"size = {layout.size}",
        f"origin = {_toml(message.origin)}",
        f"text = {_toml(sha256(message.text)[:16])}",
        f"type_hash = {_toml(type_hash)}",
        *_list("slots", map(_slot, layout.slots)),
        *(_list("defaults", defaults) if defaults else ()),
        *(_list("constants", constants) if constants else ()),
        *(_list("units", units) if units else ()),
    ]


def _slot(slot: Slot) -> str:
    count = "" if slot.count is None else f"[{slot.count}]"
    role = "" if slot.role is Role.DATA else f" ({slot.role.value})"
    type_ = str(slot.type.name) if isinstance(slot.type, Ref) else ros_type(slot.type)
    return f"{slot.offset} {slot.name} {type_}{count}{role}"


def _list(key: str, items: Iterable[str]) -> list[str]:
    """Return the lines of a TOML list with one item on each line, so that a changed item is a diff of one line."""
    inner = [f"    {_toml(item)}," for item in items]
    return [f"{key} = [", *inner, "]"] if inner else [f"{key} = []"]


def _toml(value: object) -> str:
    """Return a string, number or list in the syntax of TOML. It equals JSON, except that TOML also escapes DEL."""
    return _JSON(value).replace("\x7f", "\\u007f")


_FILE = re.compile(r'^"([^"\\]+)" = "([0-9a-f]{64})"$', re.MULTILINE)
_JSON = json.JSONEncoder(ensure_ascii=False).encode
_SLOT = re.compile(r"(\d+) (\S+) (\S+?)(?:\[(\d+)\])?(?: \((\w+)\))?")
_CONSTANT = re.compile(r"(\S+) (\S+) = (.*)", re.DOTALL)
_NAMED = re.compile(r"(\S+) = (.*)", re.DOTALL)


def _read_block(block: Any, known: Container[str]) -> Block:
    slots = [_parts(_SLOT, line) for line in block["slots"]]
    counts = {name for _, name, _, _, role in slots if role == Role.COUNT.value}
    fields = {
        name: Entry(name, _full(type_, known), int(count) if count else None, int(offset), f"{name}_count" in counts)
        for offset, name, type_, count, role in slots
        if not role
    }
    constants = [_parts(_CONSTANT, line) for line in block.get("constants", ())]
    return Block(
        str(block["digest"]),
        int(block["size"]),
        str(block["origin"]),
        str(block.get("text", "")),
        fields,
        dict(_parts(_NAMED, line) for line in block.get("defaults", ())),
        {name: f"{type_} {value}" for type_, name, value in constants},
        dict(_parts(_NAMED, line) for line in block.get("units", ())),
    )


def _full(type_: str, known: Container[str]) -> str:
    """Return the full name of a message type in layout.lock, because earlier versions wrote short names."""
    package, slash, name = type_.partition("/")
    if not slash or "/" in name:
        return type_
    names = [f"{package}/{kind}/{name}" for kind in ("msg", "srv", "action")]
    return next((full for full in names if full in known), names[0])


def _parts(pattern: re.Pattern[str], line: str) -> tuple[Any, ...]:
    match = pattern.fullmatch(line)
    if match is None:
        raise ValueError(line)
    return match.groups("")
