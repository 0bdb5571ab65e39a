"""Caches the output of commands that had nothing to do, so that the same command can print it again at once.

An entry contains a fingerprint of each file that the command read. If any byte has changed, or a file was added or
removed, the command runs in full. The entries are in the user's cache folder. This module imports little, because
loading modules takes most of the time of a short run.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterable, Iterator, Sequence

from shmgen.core import cache

_PREFIX = "clean-"
_FORMAT_VERSION = "3"
"""Version of the entry format; an older shmgen in the same folder may have written another format."""
_MAX_ENTRIES = 20
_TICK = 20_000_000
"""Longest time in ns that a file's timestamp may lag behind the clock: two timer interrupts at 100 Hz."""
_SUFFIXES = (".msg", ".srv", ".action", ".idl")
_CONTENT, _STATE, _NAMES = "CSN"
"""Kinds of fingerprints of a path: the bytes of a file, its size and time, the names in a folder."""


def static_key() -> list[str]:
    """Return the key under which to cache the output of this command line, or an empty list.

    Only outputs that depend on nothing but the installed shmgen have a key: the version, and the shell completions of
    commands and options.
    """
    shell, line, at = (os.environ.get(name, "") for name in ("_SHMGEN_COMPLETE", "COMP_WORDS", "COMP_CWORD"))
    words = line.split()
    word = "".join(words[int(at) : int(at) + 1]) if at.isdecimal() else at  # fish passes the word itself
    if shell and (at == "1" or words[1:] in ([], [at]) or word.startswith("-")):
        return ["complete", shell, line, at]
    return ["version", os.environ.get("SHMGEN_PURE", "")] if sys.argv[1:] in (["--version"], ["-V"]) else []


def load(arguments: Sequence[str]) -> str | None:
    """Return the stored output of `shmgen arguments…` in this folder, or None if a file has changed since."""
    entry = None if "--no-cache" in arguments else cache.read(_name(arguments))
    if entry is None:
        return None
    output, *lines = entry.decode(errors="surrogateescape").split("\n")
    for line in lines:
        fingerprint, _, watched = line.partition(" ")
        if _fingerprint(watched) != fingerprint:
            return None
    return output.replace("\0", "\n")


def store(arguments: Sequence[str], output: str, folders: Iterable[str], files: Sequence[str], began: int) -> None:
    """Store the output of a command, with fingerprints of the files that the output depends on.

    * `folders` are searched for definitions. `files` are all other paths that the command has read or tried to read.
    * `began` is the start of the command, in ns since 1970. If a file has changed since, nothing is stored. A command
      that wrote a file therefore has no entry.
    """
    if not hasattr(os, "geteuid"):  # Windows: cache.py stores nothing there
        return
    watched = [
        *(f"{_CONTENT}{file}" for file in files),
        *(f"{_NAMES}{place}" for place in {os.path.dirname(file) or "." for file in files}),
        *(line for folder in folders for line in _definitions(folder)),
        *(f"{_STATE}{file}" for file in _tool_files()),
    ]
    if _latest_ctime(watched) > began - _TICK:
        return
    now = {line: _fingerprint(line) for line in watched}
    text = "\n".join([output.replace("\n", "\0"), *(f"{seen} {line}" for line, seen in now.items())])
    if text.count("\n") == len(now):  # otherwise a name contains a line feed
        cache.write(_name(arguments), text.encode(errors="surrogateescape"))
        cache.forget(_PREFIX, _MAX_ENTRIES)


def _name(arguments: Sequence[str]) -> str:
    key = "\n".join([_FORMAT_VERSION, os.getcwd(), __file__, sys.version, *arguments]).encode(errors="surrogateescape")
    return f"{_PREFIX}{hashlib.sha256(key).hexdigest()[:16]}"


def _fingerprint(line: str) -> str:
    """Return a fingerprint, without blanks, of the content of a file or folder.

    `line` is a letter and a path. The letter selects what counts as content: the bytes of a file, the names in a
    folder, or the size and time of a file.
    """
    kind, path = line[:1], line[1:]
    try:
        if kind == _CONTENT:
            return _hash_of_file(path)
        if kind == _NAMES:
            names = sorted(name for name in os.listdir(path) if name != "__pycache__")
            return _hash_of_bytes("\0".join(names).encode(errors="surrogateescape"))
        state = os.stat(path)
        return f"{state.st_size}.{state.st_mtime_ns}"
    except OSError:
        return "none"


def _hash_of_bytes(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _hash_of_file(path: str) -> str:
    """Return the hash of a file's content. Uses os.read(), because open() would take twice as long.

    The time matters: a check without changes spends most of its time here.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        return _hash_of_bytes(os.read(descriptor, os.fstat(descriptor).st_size))
    finally:
        os.close(descriptor)


def _latest_ctime(watched: Iterable[str]) -> int:
    """Return the newest `ctime` of the files in ns since 1970. Programs can set `mtime` at will, but not `ctime`."""
    times = [0]
    for line in watched:
        try:
            times.append(os.stat(line[1:]).st_ctime_ns)
        except OSError:
            continue
    return max(times)


def _definitions(folder: str) -> Iterator[str]:
    """Yield the _fingerprint() lines of all paths in and below a folder that shmgen.definitions may read.

    Enter each folder once, because symbolic links may form a loop.
    """
    seen: set[tuple[int, int]] = set()
    for place, inner, names in os.walk(folder, followlinks=True):
        state = os.stat(place)
        if (state.st_dev, state.st_ino) in seen:
            inner.clear()
            continue
        seen.add((state.st_dev, state.st_ino))
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        yield f"{_NAMES}{place}"
        yield from (
            f"{_CONTENT}{os.path.join(place, name)}"
            for name in sorted(names)
            if name.endswith(_SUFFIXES) or name == "package.xml"
        )


def _tool_files() -> Iterator[str]:
    """Yield the files of shmgen and of other packages that affect the output."""
    ours = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    folders = [ours, os.path.join(os.path.dirname(os.path.dirname(ours)), "templates")]
    place = next((place for place in sys.path if os.path.isdir(os.path.join(place, "rosbags"))), "")
    folders.append(os.path.join(place, "rosbags/typesys/stores"))
    for folder in folders:
        for place, within, names in os.walk(folder):
            within[:] = sorted(name for name in within if name not in ("__pycache__", ".mypy_cache"))
            yield from (os.path.join(place, name) for name in sorted(names))
