"""Puts {path: text} into a folder: each file whole or untouched, and only where it differs."""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Set
from contextlib import closing, contextmanager, suppress
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
    staged: dict[str, str] = {}
    made: list[Path] = []
    path = ""
    try:
        made += _make_folder(folder)
        with _alone(folder) as descriptor, closing(_Below(folder, descriptor, made)) as below:
            if current(folder, last) != former:
                return None
            listed = names_in(folder, [*texts, *leftovers])
            changed = [
                path for path in texts if not _is_listed(path, listed) or current(folder, path) != texts[path].encode()
            ]
            changed.sort(key=lambda path: (path == last, path))
            removed += [path for path in abandoned(folder, listed) if _remove(folder, path)]
            beside = f".shmgen-{os.urandom(4).hex()}.tmp"
            for path in changed:
                if _is_listed(path, listed) and os.path.isdir(folder / path):
                    raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
                place, slash, name = path.rpartition("/")
                staged[path] = f"{place}{slash}.{name}{beside}"
                _stage(*below.find(staged[path]), texts[path])
            made.clear()
            for path in changed:
                if path == last:
                    removed += [leftover for leftover in leftovers if _remove(folder, leftover)]
                (temporary, there), (file, _) = below.find(staged[path]), below.find(path)
                os.replace(temporary, file, src_dir_fd=there, dst_dir_fd=there)
                del staged[path]
    except OSError as error:
        reason = f"cannot write: {error.strerror or error}"
        hint = "choose another folder with -o, or make room in this one"
        raise Rejected([Diagnostic("SHM007", reason, Span(str(given / path)), hint=hint)]) from error
    finally:
        for left in staged.values():
            with suppress(OSError):  # it did not come to be
                os.unlink(folder / left)
        for empty in reversed(made):
            with suppress(OSError):  # another run has something in it by now
                empty.rmdir()
    return Written(tuple(changed), tuple(sorted(texts.keys() - changed)), tuple(removed))


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


def abandoned(folder: Path, listed: Mapping[str, Set[str]]) -> list[str]:
    """Files that a killed run staged and did not come to rename.

    The file that was to be may have left the configuration since, so its name says nothing.
    """
    found = (f"{place}{name}" for place, names in listed.items() for name in sorted(names) if _STAGED.fullmatch(name))
    return [path for path in found if is_inside(folder, path)]


def names_in(folder: Path, paths: Iterable[str]) -> dict[str, Set[str]]:
    """The names in all folders below those where `paths` begin, `c/shm_msgs/` and so on, and last in `folder` itself.

    What a link leads to is not looked into.
    """
    listed: dict[str, Set[str]] = {}
    for room in sorted({path.partition("/")[0] for path in paths if "/" in path}):
        for place, folders, names in os.walk(folder / room):
            folders.sort()
            listed[f"{Path(place).relative_to(folder).as_posix()}/"] = {*folders, *names}
    with suppress(OSError):
        listed[""] = {*os.listdir(folder)}
    return listed


def _is_listed(path: str, listed: Mapping[str, Set[str]]) -> bool:
    """Whether there is one, or it cannot be said, being behind a link."""
    place, slash, name = path.rpartition("/")
    names = listed.get(f"{place}{slash}")
    return name in names if names is not None else bool(place) and _is_listed(place, listed)


_STAGED = re.compile(r"\..+\.shmgen-[a-z0-9_]{8}\.tmp")


@contextmanager
def _alone(folder: Path) -> Iterator[int | None]:
    """Two runs at once, of a parallel build, take turns; on Windows, or without locks in the file system, not.

    Gives a descriptor of the folder where there can be one.
    """
    if fcntl is None:
        yield None
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor
    finally:
        os.close(descriptor)


class _Below:
    """The folders below one, each opened from the one above it, so that none is a link; once, if paths are in order.

    On Windows, which opens no folders, their whole paths stand for them. Those that were missing are added to `made`.
    """

    def __init__(self, folder: Path, descriptor: int | None, made: list[Path]) -> None:
        self._folder, self._made = folder, made
        self._way: list[str] = []
        self._descriptors = [descriptor]

    def find(self, path: str) -> tuple[str | Path, int | None]:
        """The name of a file, and the descriptor of the folder that is to be seen from. Raises OSError."""
        *way, name = path.split("/")
        while self._way != way[: len(self._way)]:
            self._leave()
        for inner in way[len(self._way) :]:
            self._enter(inner)
        return (name if self._descriptors[-1] is not None else self._folder / path), self._descriptors[-1]

    def close(self) -> None:
        while self._way:
            self._leave()

    def _enter(self, name: str) -> None:
        path, above = self._folder.joinpath(*self._way, name), self._descriptors[-1]
        seen = path if above is None else name
        try:
            if stat.S_ISLNK(os.lstat(seen, dir_fd=above).st_mode):
                raise OSError(errno.ELOOP, f"{path} is a symbolic link")
        except FileNotFoundError:
            with suppress(FileExistsError):  # of another run by now
                os.mkdir(seen, dir_fd=above)
                self._made.append(path)
        flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW if above is not None else 0
        self._descriptors.append(None if above is None else os.open(seen, flags, dir_fd=above))
        self._way.append(name)

    def _leave(self) -> None:
        self._way.pop()
        descriptor = self._descriptors.pop()
        if descriptor is not None:
            os.close(descriptor)


def _make_folder(folder: Path) -> list[Path]:
    """Those that were missing, outermost first."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return missing[::-1]


def _stage(name: str | Path, folder: int | None, text: str) -> None:
    """A file beside the one it is for, that has only to be renamed."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    descriptor = os.open(name, flags, 0o666, dir_fd=folder)
    try:
        left = memoryview(text.encode())
        while left:
            left = left[os.write(descriptor, left) :]
    finally:
        os.close(descriptor)


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
