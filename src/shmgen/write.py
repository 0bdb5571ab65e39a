"""Puts {path: text} into a folder: each file whole or untouched, and only where it differs."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from shmgen.diagnostics import Diagnostic, Rejected, Span


@dataclass(frozen=True, slots=True)
class Written:
    """What happened to each path below the folder."""

    changed: tuple[str, ...]
    unchanged: tuple[str, ...]
    removed: tuple[str, ...]


def write(folder: Path, texts: Mapping[str, str], leftovers: Iterable[str], last: str) -> Written:
    """Writes all texts and removes `leftovers`, `last` at the end. Raises Rejected: SHM007.

    All files are first written beside those they replace, so a full disk is met before anything is changed.
    """
    changed = [path for path in texts if _current(folder / path) != texts[path].encode()]
    changed.sort(key=lambda path: path == last)
    removed: list[str] = []
    staged: dict[str, Path] = {}
    made: list[Path] = []
    path = ""
    try:
        for path in changed:
            made += _make_folder((folder / path).parent)
            staged[path] = _stage(folder / path, texts[path])
        made.clear()
        for path in changed:
            if path == last:
                removed += [leftover for leftover in leftovers if _remove(folder, leftover)]
            staged.pop(path).replace(folder / path)
    except OSError as error:
        reason = f"cannot write: {error.strerror or error}"
        hint = "choose another folder with -o, or make room in this one"
        raise Rejected([Diagnostic("SHM007", reason, Span(str(folder / path)), hint=hint)]) from error
    finally:
        for temporary in staged.values():
            temporary.unlink()
        for empty in reversed(made):
            empty.rmdir()
    return Written(tuple(changed), tuple(path for path in texts if path not in changed), tuple(removed))


def _current(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _make_folder(folder: Path) -> list[Path]:
    """Those that were missing, outermost first."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return missing[::-1]


def _stage(path: Path, text: str) -> Path:
    """A file beside `path` that has only to be renamed."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(text.encode())
        temporary.chmod(0o666 & ~_umask())
    except BaseException:
        temporary.unlink()
        raise
    return temporary


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
