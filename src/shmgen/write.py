"""Puts {path: text} into a folder: each file whole or untouched, and only where it differs."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from shmgen.diagnostics import Diagnostic, Rejected, Span
from shmgen.records import dataclass


@dataclass(frozen=True, slots=True)
class Written:
    """What happened to each path below the folder."""

    changed: tuple[str, ...]
    unchanged: tuple[str, ...]
    removed: tuple[str, ...]


def write(folder: Path, texts: Mapping[str, str], leftovers: Iterable[str], last: str) -> Written:
    """Writes all texts and removes `leftovers`, `last` at the end. Raises Rejected: SHM007.

    All files are first written beside those they replace, so a full disk is met before anything is changed; what
    a killed run left beside them is taken away.
    """
    leftovers = list(leftovers)
    changed = [path for path in texts if current(folder, path) != texts[path].encode()]
    changed.sort(key=lambda path: path == last)
    removed: list[str] = []
    staged: dict[str, Path] = {}
    made: list[Path] = []
    path = ""
    try:
        made += _make_folder(folder)
        with _alone(folder):
            for path in abandoned(folder, [*texts, *leftovers]):
                (folder / path).unlink()
                removed.append(path)
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


def current(folder: Path, path: str) -> bytes | None:
    """The content of a file in the folder; None if there is none that can be read."""
    try:
        with open(os.path.join(folder, path), "rb", buffering=0) as file:
            return file.read()
    except OSError:
        return None


def is_inside(folder: Path, path: str) -> bool:
    """Whether `path` is a file in `folder`, and leads to no other place."""
    file = folder / path
    return file.is_file() and folder.resolve() in file.resolve().parents


def abandoned(folder: Path, paths: Iterable[str]) -> list[str]:
    """Files that a killed run staged beside those of `paths`, and did not come to rename."""
    names: dict[str, set[str]] = {}
    for path in paths:
        place, _, name = path.rpartition("/")
        names.setdefault(place, set()).add(name)
    found: list[str] = []
    for place, expected in sorted(names.items()):
        with suppress(OSError):
            staged = [name for name in sorted(os.listdir(folder / place)) if _of_which(name) in expected]
            found += [f"{place}/{name}".lstrip("/") for name in staged]
    return [path for path in found if is_inside(folder, path)]


_STAGED = re.compile(r"\.(.+)\.[a-z0-9_]{8}\.tmp")


def _of_which(name: str) -> str:
    staged = _STAGED.fullmatch(name)
    return staged[1] if staged else ""


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Two runs at once, of a parallel build, take turns; where the file system knows no locks they do not."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


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
    if not is_inside(folder, path):
        return False
    file = folder / path
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
