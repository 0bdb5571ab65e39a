"""Puts {path: text} into a folder: each file whole or untouched, and only where it differs."""

from __future__ import annotations

import errno
import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from shmgen.core import files
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.core.fast_dataclass import dataclass

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None  # type: ignore[assignment]


@dataclass(frozen=True, slots=True)
class Written:
    """What happened to each path below the folder."""

    changed: tuple[str, ...]
    unchanged: tuple[str, ...]
    removed: tuple[str, ...]


def write(
    folder: Path, texts: Mapping[str, str], leftovers: Iterable[str], last: str, former: bytes | None = None
) -> Written | None:
    """Writes all texts and removes `leftovers`, `last` at the end. Raises Rejected: SHM007.

    `former` is what `last` was when `texts` and `leftovers` were made; None and nothing written if another run has
    written since. All files are first written beside those they replace, so a full disk is met before anything is
    changed; what a killed run left beside them is taken away.
    """
    leftovers = list(leftovers)
    given, folder = folder, _reachable(folder)
    removed: list[str] = []
    staged: dict[str, Path] = {}
    made: list[Path] = []
    path = ""
    try:
        made += _make_folder(folder)
        with _alone(folder):
            if current(folder, last) != former:
                return None
            changed = [path for path in texts if current(folder, path) != texts[path].encode()]
            changed.sort(key=lambda path: path == last)
            removed += [path for path in abandoned(folder, [*texts, *leftovers]) if _remove(folder, path)]
            for path in changed:
                _stay_inside(folder, path)
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
        raise Rejected([Diagnostic("SHM007", reason, Span(str(given / path)), hint=hint)]) from error
    finally:
        for temporary in staged.values():
            temporary.unlink()
        for empty in reversed(made):
            with suppress(OSError):  # another run has something in it by now
                empty.rmdir()
    return Written(tuple(changed), tuple(path for path in texts if path not in changed), tuple(removed))


def current(folder: Path, path: str) -> bytes | None:
    """The content of a file in the folder; None if there is none that can be read.

    A checkout on Windows may have lines that end in CR LF; they count as those that were written.
    """
    try:
        name = os.path.join(folder, path) if os.name != "nt" else _reachable(folder) / path
        kept = files.content(name)
        return kept.replace(b"\r\n", b"\n") if b"\r" in kept else kept
    except OSError:
        return None


def _reachable(folder: Path) -> Path:
    """The same folder, by a name that on Windows may lead to paths of more than 260 characters."""
    if os.name != "nt" or str(folder).startswith("\\\\"):
        return folder
    return Path("\\\\?\\" + os.path.abspath(folder))


def is_inside(folder: Path, path: str) -> bool:
    """Whether `path` is a file in `folder`, and leads to no other place."""
    file = folder / path
    return file.is_file() and folder.resolve() in file.resolve().parents


def abandoned(folder: Path, paths: Iterable[str]) -> list[str]:
    """Files that a killed run staged in the folders of `paths`, or below them, and did not come to rename.

    The file that was to be may have left the configuration since, so its name says nothing.
    """
    found: list[str] = []
    for room in sorted({path.partition("/")[0] for path in paths if "/" in path}):
        for place, folders, names in os.walk(folder / room):
            folders.sort()
            found += [os.path.join(place, name) for name in sorted(names) if _STAGED.fullmatch(name)]
    with suppress(OSError):
        found += [str(folder / name) for name in sorted(os.listdir(folder)) if _STAGED.fullmatch(name)]
    inside = (Path(os.path.relpath(path, folder)).as_posix() for path in found)
    return [path for path in inside if is_inside(folder, path)]


_STAGED = re.compile(r"\..+\.shmgen-[a-z0-9_]{8}\.tmp")


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Two runs at once, of a parallel build, take turns; on Windows, or without locks in the file system, not."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _stay_inside(folder: Path, path: str) -> None:
    """Raises OSError where a folder on the way is a link: what is written there would be written elsewhere."""
    for parent in Path(path).parents:
        if (folder / parent).is_symlink() and parent != Path():
            raise OSError(errno.ELOOP, f"{folder / parent} is a symbolic link")


def _make_folder(folder: Path) -> list[Path]:
    """Those that were missing, outermost first."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return missing[::-1]


def _stage(path: Path, text: str) -> Path:
    """A file beside `path` that has only to be renamed."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.shmgen-", suffix=".tmp")
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
