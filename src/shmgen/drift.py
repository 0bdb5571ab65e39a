"""Turns Layouts and printed files into layout.lock, and reads it back: what was generated, from what, and how."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass

from shmgen.diagnostics import Report, Span
from shmgen.model import Layout, Layouts, Role, Slot, ros_type

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LOCK = "layout.lock"
VERSION = 1


@dataclass(frozen=True, slots=True)
class Lock:
    """What a former run left: the messages asked for, and the SHA-256 of each file it wrote."""

    requested: tuple[str, ...] = ()
    files: Mapping[str, str] | None = None


def write(layouts: Layouts, texts: Mapping[str, str], settings: Mapping[str, object]) -> str:
    """The text of layout.lock: stable order, one line a slot, no date, no host, no version of ours."""
    lines = [
        "# What `shmgen generate` wrote, and from what. Commit it with the generated files.",
        f"version = {VERSION}",
        "requested = [",
        *(f"    {_quoted(str(layout.name))}," for layout in _sorted(layouts) if layout.requested),
        "]",
        "",
        "[settings]",
        *(f"{key} = {json.dumps(value)}" for key, value in settings.items()),
    ]
    for layout in _sorted(layouts):
        lines += ["", *_block(layout)]
    lines += ["", "[files]", *(f"{_quoted(path)} = {_quoted(sha256(text))}" for path, text in sorted(texts.items()))]
    return "\n".join(lines) + "\n"


def read(text: str, shown: str, report: Report) -> Lock:
    """Takes a lock apart; one that no run of ours wrote is reported as SHM401."""
    try:
        data = tomllib.loads(text)
        requested, files = data["requested"], data["files"]
        if data["version"] != VERSION or not all(isinstance(item, str) for item in [*requested, *files.values()]):
            raise ValueError("version")
        return Lock(tuple(requested), dict(files))
    except (tomllib.TOMLDecodeError, KeyError, TypeError, ValueError, AttributeError):
        report.error(
            "SHM401",
            "layout.lock is damaged, so it cannot be known which files are generated",
            Span(shown),
            hint="restore it from version control, or delete it and the generated files, and run `shmgen generate`",
        )
        return Lock()


def sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _sorted(layouts: Layouts) -> list[Layout]:
    return [layouts[name] for name in sorted(layouts)]


def _block(layout: Layout) -> list[str]:
    return [
        f"[messages.{_quoted(str(layout.name))}]",
        f"digest = {_quoted(f'{layout.digest:016x}')}",
        f"size = {layout.size}",
        f"origin = {_quoted(layout.message.origin)}",
        "slots = [",
        *(f"    {_quoted(_slot(slot))}," for slot in layout.slots),
        "]",
    ]


def _slot(slot: Slot) -> str:
    count = "" if slot.count is None else f"[{slot.count}]"
    role = "" if slot.role is Role.DATA else f" ({slot.role.value})"
    return f"{slot.offset} {slot.name} {ros_type(slot.type)}{count}{role}"


def _quoted(text: str) -> str:
    """A TOML basic string; JSON's escapes are a subset of TOML's but for DEL."""
    return json.dumps(text).replace("\x7f", "\\u007f")
