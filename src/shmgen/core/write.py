"""Write generated files into a folder. Each file is replaced as a whole, and only if its content differs."""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Container, Iterable, Iterator, Mapping, Set
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from shmgen.core import files
from shmgen.core.diagnostics import Diagnostic, Rejected, Span

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None  # type: ignore[assignment]


class Written(NamedTuple):
    """The result of write(): the paths of the changed and the removed files, relative to the folder."""

    changed: tuple[str, ...]
    removed: tuple[str, ...]


def write(
    folder: Path, texts: Mapping[str, str], leftovers: Iterable[str], last: str, former: bytes | None = None
) -> Written | None:
    """Write the texts into files of the folder, by path, and remove the files `leftovers`. Raises Rejected: SHM007.

    * `last` is the path of the file that is written at the end.
    * `former` is the content of `last` that the caller read to compute `texts` and `leftovers`. If another run has
      changed `last` since then, write nothing and return None.
    * Each text is first written to a temporary file, so that a full disk is noticed before any file changes.
    * Temporary files of killed runs are removed.
    """
    leftovers = list(leftovers)
    shown_folder, folder = folder, _reachable(folder)
    removed: list[str] = []
    staged: dict[str, str] = {}
    created: list[Path] = []
    path = ""
    try:
        created += _make_folder(folder)
        with _lock_folder(folder) as descriptor, closing(_FolderTree(folder, descriptor, created)) as below:
            if current(folder, last) != former:
                return None
            listed = names_in(folder, [*texts, *leftovers])
            changed = [
                path for path in texts if not _is_listed(path, listed) or current(folder, path) != texts[path].encode()
            ]
            changed.sort(key=lambda path: (path == last, path))
            removed += [path for path in temporary_files(folder, listed) if _remove(folder, path)]
            beside = f".shmgen-{os.urandom(4).hex()}.tmp"
            for path in changed:
                if _is_listed(path, listed) and os.path.isdir(folder / path):
                    raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
                place, slash, name = path.rpartition("/")
                staged[path] = f"{place}{slash}.{name}{beside}"
                _stage(*below.find(staged[path]), texts[path])
            created.clear()
            for path in changed:
                if path == last:
                    removed += [leftover for leftover in leftovers if _remove(folder, leftover)]
                (temporary, there), (file, _) = below.find(staged[path]), below.find(path)
                os.replace(temporary, file, src_dir_fd=there, dst_dir_fd=there)
                del staged[path]
    except OSError as error:
        reason = f"cannot write: {error.strerror or error}"
        hint = "correct the cause at this path, or choose another folder with -o"
        raise Rejected([Diagnostic("SHM007", reason, Span(str(shown_folder / path)), hint=hint)]) from error
    finally:
        for temporary_file in staged.values():
            with suppress(OSError):  # it was not created
                os.unlink(folder / temporary_file)
        for empty in reversed(created):
            with suppress(OSError):  # another run has put a file into it
                empty.rmdir()
    return Written(tuple(changed), tuple(removed))


def current(folder: Path, path: str) -> bytes | None:
    """Return the content of a file in the folder, or None if the file cannot be read.

    CR LF becomes LF, because a checkout on Windows may have replaced the line ends that shmgen wrote.
    """
    try:
        name = os.path.join(folder, path) if os.name != "nt" else _reachable(folder) / path
        data = files.read_file(name)
        return data.replace(b"\r\n", b"\n") if b"\r" in data else data
    except OSError:
        return None


def _reachable(folder: Path) -> Path:
    """Return a path of the folder that, on Windows, allows files with more than 260 characters in their paths."""
    if os.name != "nt" or str(folder).startswith("\\\\"):
        return folder
    return Path("\\\\?\\" + os.path.abspath(folder))


def is_inside(folder: Path, path: str) -> bool:
    """Return True if `path` is a file in `folder`, and no symlink leads out of the folder."""
    file = folder / path
    return file.is_file() and folder.resolve() in file.resolve().parents


def temporary_files(folder: Path, listed: Mapping[str, Set[str]]) -> list[str]:
    """Return the temporary files that killed runs have left in the folder, before they could rename these files.

    `listed` has the names in each folder: see names_in(). The files of all targets are included, because the
    configuration may no longer contain the target of a killed run.
    """
    paths = (f"{place}{name}" for place, names in listed.items() for name in sorted(names) if _STAGED.fullmatch(name))
    return [path for path in paths if is_inside(folder, path)]


def unlisted(folder: Path, known: Container[str], listed: Mapping[str, Set[str]]) -> list[str]:
    """Return the files in the folder that shmgen has generated but that `known`, the files of this run, does not have.

    `listed` has the names in each folder: see names_in(). Such files exist if layout.lock was lost, or restored from
    another state. The caller reports the files but does not remove them, because a user may have edited or copied them.
    """
    below = ((place, name) for place, names in listed.items() if place and "__pycache__" not in place for name in names)
    paths = sorted(f"{place}{name}" for place, name in below if not name.startswith("."))
    return [path for path in paths if path not in known and is_inside(folder, path) and _is_ours(folder / path)]


def _is_ours(file: Path) -> bool:
    with suppress(OSError), files.open_file(file) as stream:
        return b"Generated by shmgen (" in stream.read(_HEAD)
    return False


_HEAD = 2000
"""Bytes at the start of a file within which a generated file names shmgen as its author."""


def names_in(folder: Path, paths: Iterable[str]) -> dict[str, Set[str]]:
    """Return the names that exist in each folder with generated files, such as `c/shm_msgs/`.

    The keys are the folders, the values the names of files and folders in each folder. The key "" stands for `folder`
    itself. The other keys are the top folders of `paths`, and all folders below. Symlinks are not followed.
    """
    listed: dict[str, Set[str]] = {}
    for top in sorted({path.partition("/")[0] for path in paths if "/" in path}):
        for place, folders, names in os.walk(folder / top):
            folders.sort()
            listed[f"{Path(place).relative_to(folder).as_posix()}/"] = {*folders, *names}
    with suppress(OSError):
        listed[""] = {*os.listdir(folder)}
    return listed


def _is_listed(path: str, listed: Mapping[str, Set[str]]) -> bool:
    """Return True if the file `path` may exist. `listed` is the result of names_in().

    names_in() does not list folders behind symlinks. Every file below such a folder may exist.
    """
    place, slash, name = path.rpartition("/")
    names = listed.get(f"{place}{slash}")
    return name in names if names is not None else bool(place) and _is_listed(place, listed)


_STAGED = re.compile(r"\..+\.shmgen-[a-z0-9_]{8}\.tmp")


@contextmanager
def _lock_folder(folder: Path) -> Iterator[int | None]:
    """Wait until no other run writes into the folder, as in a parallel build. Yield a descriptor of the locked folder.

    On Windows, yield None. On Windows, and on a file system without locks, two runs may write at the same time.
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


class _FolderTree:
    """Opens folders below a given folder so that no symlink is followed: each folder is opened from its parent.

    If the caller passes paths in sorted order, each folder is opened once. Missing folders are created and added to
    `created`. On Windows, no folder is opened, and find() returns whole paths.
    """

    def __init__(self, folder: Path, descriptor: int | None, created: list[Path]) -> None:
        self._folder, self._created = folder, created
        self._way: list[str] = []
        self._descriptors = [descriptor]

    def find(self, path: str) -> tuple[str | Path, int | None]:
        """Open the folder of the file `path`. Return the arguments for calls such as os.open(name, dir_fd=descriptor).

        They are the name of the file and the descriptor of its folder; on Windows, the whole path and None.
        Raises OSError if a folder is a symlink or cannot be opened.
        """
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
                self._created.append(path)
        flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW if above is not None else 0
        self._descriptors.append(None if above is None else os.open(seen, flags, dir_fd=above))
        self._way.append(name)

    def _leave(self) -> None:
        self._way.pop()
        descriptor = self._descriptors.pop()
        if descriptor is not None:
            os.close(descriptor)


def _make_folder(folder: Path) -> list[Path]:
    """Create the folder with its parents. Return the folders that did not exist before, outermost first."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return missing[::-1]


def _stage(name: str | Path, folder: int | None, text: str) -> None:
    """Write the text into a new temporary file `name`, which the caller later renames to its final name."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    with open(os.open(name, flags, 0o666, dir_fd=folder), "wb") as file:
        file.write(text.encode())


def _remove(folder: Path, path: str) -> bool:
    """Remove the file `path` and the folders that become empty. Return False if `path` is not a file in `folder`."""
    if not is_inside(folder, path):
        return False
    file = folder / path
    file.unlink()
    for parent in file.parents:
        if parent == folder or any(parent.iterdir()):
            break
        parent.rmdir()
    return True
