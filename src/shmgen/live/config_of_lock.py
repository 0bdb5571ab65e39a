"""The configuration that the layouts of a layout.lock came from."""

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
"""Where `shmgen generate` leaves it, seen from the folder of shmgen.toml."""


@dataclass(frozen=True, slots=True)
class Known:
    """The layout of a message as some file says it: digest, bytes of the payload, and which file that is."""

    digest: int
    size: int
    origin: str

    def __str__(self) -> str:
        return f"digest 16#{self.digest:016X}, {counted(self.size, 'byte')}, by {self.origin}"


def read(file: Path) -> dict[str, Any]:
    """The lock as TOML has it; empty if there is none. Raises Rejected: SHM408."""
    try:
        lock = toml.loads(files.content(file).decode())
        layouts(lock, str(file))
        settings(lock, Config(Path()))
    except OSError:
        return {}
    except (KeyError, TypeError, ValueError, AttributeError):
        hint = "restore it from version control, or delete it and the generated files, and run `shmgen generate`"
        message = "layout.lock is damaged, so it cannot be known what it was made from"
        raise Rejected([Diagnostic("SHM408", message, Span(str(file)), hint=hint)]) from None
    return lock


def layouts(lock: dict[str, Any], origin: str) -> dict[str, Known]:
    """`geometry_msgs/msg/Pose` -> its layout."""
    messages = lock.get("messages", {})
    return {name: Known(int(message["digest"], 16), message["size"], origin) for name, message in messages.items()}


def settings(lock: dict[str, Any], config: Config) -> Config:
    """`config` with the source, types and bounds that the lock was written with; folders stay as they are."""
    said = lock["settings"]
    types = TypeOptions(said["bool"], said["time"], said["encoding"], said["overflow"])
    strings: dict[str, Bound] = {}
    sequences: dict[str, Bound] = {}
    for name, message in lock["messages"].items():
        package, _, bare = name.split("/")
        counted = ""
        for offset, field, type_, count, role in map(_slot, message["slots"]):
            key = f"{package}/{bare}.{field}"
            if role == "count":
                counted = field.removesuffix("_count")
            elif not role and field == counted:
                sequences[key] = Bound(int(count), Span(f"{LOCK}", int(offset)))
            if not role and (text := _STRING.fullmatch(type_)):
                strings[key] = Bound(int(text[1]), Span(f"{LOCK}", int(offset)))
    return replace(config, source=said["source"], types=types, bounds=Bounds(strings, sequences))


_SLOT = re.compile(r"(\d+) (\S+) (\S+?)(?:\[(\d+)\])?(?: \((\w+)\))?")
_STRING = re.compile(r"w?string<=(\d+)")


def _slot(line: str) -> tuple[str, str, str, str, str]:
    """Offset, name, type, count, role of a line such as `44 name string<=80[8]`, as layout.lock has them."""
    found = _SLOT.fullmatch(line)
    if found is None:
        raise ValueError(f"{LOCK}: {line!r} is no slot")
    offset, name, type_, count, role = found.groups("")
    return offset, name, type_, count, role
