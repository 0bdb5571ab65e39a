"""Puts {path: text} into a folder: each file whole or untouched, and only where it differs."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from shmgen.diagnostics import Rejected, Report, Span


@dataclass(frozen=True, slots=True)
class Written:
    """What happened to each path below the folder."""

    changed: tuple[str, ...]
    unchanged: tuple[str, ...]
    removed: tuple[str, ...]


def write(folder: Path, texts: Mapping[str, str], leftovers: Iterable[str], last: str) -> Written:
    """Writes all texts, `last` at the end, then removes `leftovers`. Raises Rejected: SHM007."""
    changed = [path for path in texts if _current(folder / path) != texts[path].encode()]
    changed.sort(key=lambda path: path == last)
    try:
        for path in changed:
            _replace(folder / path, texts[path])
        removed = [path for path in leftovers if _remove(folder, path)]
    except OSError as error:
        report = Report()
        where = str(error.filename or folder)
        report.error("SHM007", f"cannot write: {error.strerror}", Span(where), hint="choose another folder with -o")
        raise Rejected(report.diagnostics) from error
    return Written(tuple(changed), tuple(path for path in texts if path not in changed), tuple(removed))


def _current(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _replace(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(text.encode())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _remove(folder: Path, path: str) -> bool:
    """Removes one file and the folders it leaves empty; a path that leads out of `folder` is left alone."""
    file = folder / path
    if not file.is_file() or folder.resolve() not in file.resolve().parents:
        return False
    file.unlink()
    for parent in file.parents:
        if parent == folder or any(parent.iterdir()):
            break
        parent.rmdir()
    return True


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
