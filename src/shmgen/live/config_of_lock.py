"""Restore the configuration from which a layout.lock was generated."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core import files
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.core.model import TypeOptions
from shmgen.core.plural import counted
from shmgen.drift import lockfile
from shmgen.drift.lockfile import Lock

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


def read(file: Path) -> Lock | None:
    """Return the content of layout.lock, or None if the file is missing.

    Raises Rejected (SHM408) if the file is damaged.
    """
    try:
        lock = lockfile.parse(files.read_file(file).decode())
        layouts(lock, str(file))
        settings(lock, Config(Path()))
    except OSError:
        return None
    except (KeyError, TypeError, ValueError, AttributeError):
        hint = "restore it from version control, or delete it and the generated files, and run `shmgen generate`"
        message = "layout.lock is damaged, so shmgen cannot determine the settings of the generated files"
        raise Rejected([Diagnostic("SHM408", message, Span(str(file)), hint=hint)]) from None
    return lock


def layouts(lock: Lock, origin: str) -> dict[str, Known]:
    """Return the layout of each message in layout.lock, by the message's name, such as `geometry_msgs/msg/Pose`."""
    return {name: Known(int(block.digest, 16), block.size, origin) for name, block in lock.messages.items()}


def settings(lock: Lock, config: Config) -> Config:
    """Return a copy of `config` whose source, types and bounds are those in layout.lock.

    All other settings stay as in `config`.
    """
    recorded = lock.settings
    types = TypeOptions(recorded["bool"], recorded["time"], recorded["encoding"], recorded["overflow"])
    strings: dict[str, Bound] = {}
    sequences: dict[str, Bound] = {}
    for name, block in lock.messages.items():
        package, _, bare = name.split("/")
        for entry in block.fields.values():
            key, place = f"{package}/{bare}.{entry.name}", Span(f"{LOCK}", entry.offset)
            if entry.is_sequence and entry.count is not None:
                sequences[key] = Bound(entry.count, place)
            if text := _STRING.fullmatch(entry.type):
                strings[key] = Bound(int(text[1]), place)
    return replace(config, source=recorded["source"], types=types, bounds=Bounds(strings, sequences))


_STRING = re.compile(r"w?string<=(\d+)")
