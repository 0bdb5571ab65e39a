"""Implements `generate --link FOLDER`, where FOLDER is the output of another run of `generate`.

The messages in FOLDER keep the bounds of the other run. This run must give these messages the same layout.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from shmgen.config import Config
from shmgen.config.entries import Bound
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.definitions import Library
from shmgen.drift import lockfile
from shmgen.drift.compare import compare
from shmgen.drift.findings import Severity


def configured(config: Config, folders: Iterable[Path], opened: Library) -> Config:
    """Add the content of each folder's layout.lock to the configuration: bounds, generated files, requested messages.

    Bounds of messages that the library `opened` does not contain are left out.
    Raises Rejected if a layout.lock is missing (SHM407) or damaged (SHM408).
    """
    from shmgen.live import config_of_lock

    strings: dict[str, Bound] = {}
    sequences: dict[str, Bound] = {}
    files: dict[str, str] = {}
    in_reach = set(map(str, opened.known()))
    for folder in folders:
        lock = config_of_lock.read(folder / lockfile.LOCK)
        if lock is None:
            hint = "give a folder that `shmgen generate` has written"
            raise Rejected([Diagnostic("SHM407", "layout.lock is missing", Span(str(folder)), hint=hint)])
        messages = {name: block for name, block in lock.messages.items() if name in in_reach}
        linked_bounds = config_of_lock.settings(lock._replace(messages=messages), config).bounds
        strings |= linked_bounds.strings
        sequences |= linked_bounds.sequences
        files |= {**lock.files, **dict.fromkeys(lock.requested, "")}
    bounds = config.bounds._replace(
        strings=strings | {**config.bounds.strings}, sequences=sequences | {**config.bounds.sequences}
    )
    return replace(config, bounds=bounds, linked=files)


def check(text: str, locks: Sequence[Path]) -> None:
    """Raise Rejected (SHM401) if a message has another layout in layout.lock `text` than in one of `locks`."""
    ours = lockfile.read(text, lockfile.LOCK) if locks else lockfile.Lock()
    mismatches: list[Diagnostic] = []
    for file in locks:
        theirs = lockfile.read(file.read_text(encoding="utf-8"), str(file))
        both = theirs.messages.keys() & ours.messages.keys()
        before, after = (lockfile.Lock(messages={name: one.messages[name] for name in both}) for one in (theirs, ours))
        mismatches += [it.diagnostic for it in compare(before, after, str(file)) if it.severity is Severity.BREAKING]
    if mismatches:
        hint = "use the same bounds and [types] in both projects, or generate the linked project again"
        raise Rejected([one._replace(hint=hint) for one in mismatches])
