"""Restore the configuration from which a layout.lock was generated."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core import files, toml
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.core.model import TypeOptions
from shmgen.core.plural import counted

LOCK = Path("generated", "layout.lock")
"""Default path of layout.lock, relative to the folder of shmgen.toml."""


@dataclass(frozen=True, slots=True)
class Known:
    """The layout of a message according to shmgen.toml or layout.lock, for comparisons.

    `size` is the size of the message in bytes, and `origin` is the name of the file.
    """

    digest: int
    size: int
    origin: str

    def __str__(self) -> str:
        return f"digest 16#{self.digest:016X}, {counted(self.size, 'byte')}, by {self.origin}"


def read(file: Path) -> dict[str, Any]:
    """Return the content of layout.lock, or `{}` if the file is missing.

    Raises Rejected (SHM408) if the file is damaged.
    """
    try:
        lock = toml.loads(files.read_file(file).decode())
        layouts(lock, str(file))
        settings(lock, Config(Path()))
    except OSError:
        return {}
    except (KeyError, TypeError, ValueError, AttributeError):
        hint = "restore it from version control, or delete it and the generated files, and run `shmgen generate`"
        message = "layout.lock is damaged, so shmgen cannot determine the settings of the generated files"
        raise Rejected([Diagnostic("SHM408", message, Span(str(file)), hint=hint)]) from None
    return lock


def layouts(lock: dict[str, Any], origin: str) -> dict[str, Known]:
    """Return the layout of each message in layout.lock, by the message's name, such as `geometry_msgs/msg/Pose`."""
    messages = lock.get("messages", {})
    return {name: Known(int(message["digest"], 16), message["size"], origin) for name, message in messages.items()}


def settings(lock: dict[str, Any], config: Config) -> Config:
    """Return a copy of `config` whose source, types and bounds are those in layout.lock.

    `lock` is the parsed layout.lock. All other settings stay as in `config`.
    """
    recorded = lock["settings"]
    types = TypeOptions(recorded["bool"], recorded["time"], recorded["encoding"], recorded["overflow"])
    strings: dict[str, Bound] = {}
    sequences: dict[str, Bound] = {}
    for name, message in lock["messages"].items():
        package, _, bare = name.split("/")
        counted_field = ""
        for offset, field, type_, count, role in map(_slot, message["slots"]):
            key = f"{package}/{bare}.{field}"
            if role == "count":
                counted_field = field.removesuffix("_count")
            elif not role and field == counted_field:
                sequences[key] = Bound(int(count), Span(f"{LOCK}", int(offset)))
            if not role and (text := _STRING.fullmatch(type_)):
                strings[key] = Bound(int(text[1]), Span(f"{LOCK}", int(offset)))
    return replace(config, source=recorded["source"], types=types, bounds=Bounds(strings, sequences))


_SLOT = re.compile(r"(\d+) (\S+) (\S+?)(?:\[(\d+)\])?(?: \((\w+)\))?")
_STRING = re.compile(r"w?string<=(\d+)")


def _slot(line: str) -> tuple[str, str, str, str, str]:
    """Split a line of layout.lock, such as `44 name string<=80[8]`, into offset, name, type, count and role.

    The role is `""` for the data of a field, otherwise a word such as `count` or `padding`.
    """
    match = _SLOT.fullmatch(line)
    if match is None:
        raise ValueError(f"{LOCK}: {line!r} is no slot")
    offset, name, type_, count, role = match.groups("")
    return offset, name, type_, count, role
