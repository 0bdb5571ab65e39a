"""Remembers that check, or generate, found nothing to do, and everything it looked at, so that it need not look again.

Loads next to nothing, as most of a short run is Python reading modules. What is remembered is in the user's cache
folder; a byte changed anywhere that the command looked at, or a file more or less, and it is run in full.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterable, Iterator, Sequence

from shmgen.core import cache

_KIND = "clean-"
_KEPT = 20
_TICK = 20_000_000
"""Nanoseconds that the time of a file may be behind the clock: two jiffies of the slowest Linux."""
_SUFFIXES = (".msg", ".srv", ".action", ".idl")
_PIECE = 1 << 16
"""Bytes that are read at once; most files are shorter."""
_CONTENT, _STATE, _NAMES = "CSN"
"""What of a path counts: the bytes of a file, its size and time, the names in a folder."""


def fixed() -> list[str]:
    """Names the answers that hang on this shmgen alone: its version, and what completes commands and options.

    Empty where something else is asked.
    """
    shell, line, at = (os.environ.get(name, "") for name in ("_SHMGEN_COMPLETE", "COMP_WORDS", "COMP_CWORD"))
    words = line.split()
    word = "".join(words[int(at) : int(at) + 1]) if at.isdecimal() else at  # fish gives the word itself
    if shell and (at == "1" or words[1:] in ([], [at]) or word.startswith("-")):
        return ["complete", shell, line, at]
    return ["version", os.environ.get("SHMGEN_PURE", "")] if sys.argv[1:] in (["--version"], ["-V"]) else []


def load(arguments: Sequence[str]) -> str | None:
    """What `shmgen arguments…` would print in this folder, if nothing has changed since it was clean."""
    kept = None if "--no-cache" in arguments else cache.read(_name(arguments))
    if kept is None:
        return None
    digest, said, *watched = kept.decode(errors="surrogateescape").split("\n")
    return said.replace("\0", "\n") if digest == _digest(watched) else None


def store(arguments: Sequence[str], said: str, folders: Iterable[str], files: Sequence[str], began: int) -> None:
    """`folders` are where definitions are looked for, `files` all others that were read or might have been.

    What was touched since the command `began`, in ns since 1970, may not be what it saw: then nothing is remembered.
    """
    if not hasattr(os, "geteuid"):  # on Windows, where cache.py keeps nothing
        return
    places = sorted({os.path.dirname(file) or "." for file in files})
    watched = [
        *(f"{_CONTENT}{file}" for file in files),
        *(f"{_NAMES}{place}" for place in places),
        *(line for folder in folders for line in _definitions(folder)),
        *(f"{_STATE}{file}" for file in _tool()),
    ]
    text = "\n".join([_digest(watched), said.replace("\n", "\0"), *watched])
    if text.count("\n") != len(watched) + 1 or _touched(watched) > began - _TICK:  # the former: a line feed in a name
        return
    cache.write(_name(arguments), text.encode(errors="surrogateescape"))
    cache.forget(_KIND, _KEPT)


def _name(arguments: Sequence[str]) -> str:
    key = "\n".join([os.getcwd(), __file__, sys.version, *arguments]).encode(errors="surrogateescape")
    return f"{_KIND}{hashlib.sha256(key).hexdigest()[:16]}"


def _digest(watched: Iterable[str]) -> str:
    whole = hashlib.sha256()
    for line in watched:
        kind, path = line[:1], line[1:]
        try:
            if kind == _CONTENT:
                seen = _hash(path)
            elif kind == _NAMES:
                names = sorted(name for name in os.listdir(path) if name != "__pycache__")
                seen = "\0".join(names).encode(errors="surrogateescape")
            else:
                state = os.stat(path)
                seen = b"%d %d" % (state.st_size, state.st_mtime_ns)
        except OSError:
            seen = b"none"
        whole.update(b"%d\0%b\0%b" % (len(seen), line.encode(errors="surrogateescape"), seen))
    return whole.hexdigest()


def _hash(path: str) -> bytes:
    """Of a file. It is most of a check that nothing has changed for, and open() would add as much again."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        piece = os.read(descriptor, _PIECE)
        found = hashlib.sha256(piece)
        while len(piece) == _PIECE:
            piece = os.read(descriptor, _PIECE)
            found.update(piece)
        return found.digest()
    finally:
        os.close(descriptor)


def _touched(watched: Iterable[str]) -> int:
    """When the youngest of them became what it is, in ns since 1970. `ctime`, as `mtime` is anybody's to set."""
    times = [0]
    for line in watched:
        try:
            times.append(os.stat(line[1:]).st_ctime_ns)
        except OSError:
            continue
    return max(times)


def _definitions(folder: str) -> Iterator[str]:
    """All that `definitions` may look at in and below a folder; links to folders are followed, once each."""
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


def _tool() -> Iterator[str]:
    """Our own files, and those of others that have a say in what is written."""
    ours = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    folders = [ours, os.path.join(os.path.dirname(os.path.dirname(ours)), "templates")]
    place = next((place for place in sys.path if os.path.isdir(os.path.join(place, "rosbags"))), "")
    folders.append(os.path.join(place, "rosbags/typesys/stores"))
    for folder in folders:
        for place, within, names in os.walk(folder):
            within[:] = sorted(name for name in within if name not in ("__pycache__", ".mypy_cache"))
            yield from (os.path.join(place, name) for name in sorted(names))
