"""Remembers that check, or generate, found nothing to do, and everything it looked at, so that it need not look again.

Loads next to nothing, as most of a short run is Python reading modules. What is remembered is in the user's cache
folder; a byte changed anywhere that the command looked at, or a file more or less, and it is run in full.
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence

from shmgen.core import cache

_KIND = "clean-"
_FORM = "2"
"""Of what is kept; a former shmgen, of the same place, had another."""
_KEPT = 20
_TICK = 20_000_000
"""Nanoseconds that the time of a file may be behind the clock: two jiffies of the slowest Linux."""
_SUFFIXES = (".msg", ".srv", ".action", ".idl")
_PIECE = 1 << 16
"""Bytes that are read at once; most files are shorter."""
_CONTENT, _DEFINITION, _STATE, _NAMES = "CDSN"
"""What of a path counts: the bytes of a file, here a definition, its size and time, the names in a folder."""
_compared: tuple[list[str], str, dict[str, str], list[str], int] | None = None
"""What load() has found changed, and when it began: for changed() and store_again()."""


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
    global _compared
    kept = None if "--no-cache" in arguments else cache.read(_name(arguments))
    if kept is None:
        return None
    began = time.time_ns()
    said, *lines = kept.decode(errors="surrogateescape").split("\n")
    now, changed = {}, []
    for line in lines:
        seen, _, watched = line.partition(" ")
        now[watched] = _seen(watched)
        if now[watched] != seen:
            changed.append(watched)
    _compared = [*arguments], said, now, changed, began
    return None if changed else said.replace("\0", "\n")


def changed(arguments: Sequence[str], still: Mapping[str, bytes | None]) -> list[str] | None:
    """The definitions that alone have changed since that was so; None if more has, or it never was.

    The files `still` must be what they were when load() looked.
    """
    if _compared is None or _compared[0] != [*arguments] or any(it[0] != _DEFINITION for it in _compared[3]):
        return None
    same = all(_compared[2].get(_CONTENT + file) == _hashed(content or b"") for file, content in still.items())
    return [it[1:] for it in _compared[3]] if same else None


def store_again(written: Mapping[str, str]) -> None:
    """That all is done that the definitions of changed() asked for, and what was written for it."""
    assert _compared
    arguments, said, now, changed, began = _compared
    if _touched(changed) <= began - _TICK:
        now |= {_CONTENT + file: _hashed(text.encode()) for file, text in written.items()}
        _write(arguments, said, now)


def store(
    arguments: Sequence[str],
    said: str,
    folders: Iterable[str],
    files: Sequence[str],
    began: int,
    written: Mapping[str, str] | None = None,
) -> None:
    """`folders` are where definitions are looked for, `files` all others that were read or might have been.

    What was touched since the command `began`, in ns since 1970, may not be what it saw: then nothing is remembered.
    What it has `written` itself is what it should be, whatever is there by now.
    """
    if not hasattr(os, "geteuid"):  # on Windows, where cache.py keeps nothing
        return
    written = written or {}
    places = dict.fromkeys(os.path.dirname(file) or "." for file in files)
    fresh = {os.path.dirname(file) or "." for file in written}
    definitions = {line for folder in folders for line in _definitions(folder)}
    watched = [
        *(f"{_CONTENT}{file}" for file in files),
        *(f"{_NAMES}{place}" for place in places),
        *definitions,
        *(f"{_STATE}{file}" for file in _tool()),
    ]
    own = {_CONTENT + file for file in written} | {_NAMES + place for place in fresh}
    is_staged = any(name.endswith(".tmp") for place in fresh for name in os.listdir(place))  # of a run beside this one
    if is_staged or _touched(line for line in watched if line not in own or line in definitions) > began - _TICK:
        return
    now = {line: _seen(line) for line in watched}
    _write(arguments, said, now | {_CONTENT + file: _hashed(text.encode()) for file, text in written.items()})


def _write(arguments: Sequence[str], said: str, now: Mapping[str, str]) -> None:
    text = "\n".join([said.replace("\n", "\0"), *(f"{seen} {line}" for line, seen in now.items())])
    if text.count("\n") == len(now):  # else a name has a line feed in it
        cache.write(_name(arguments), text.encode(errors="surrogateescape"))
        cache.forget(_KIND, _KEPT)


def _name(arguments: Sequence[str]) -> str:
    key = "\n".join([_FORM, os.getcwd(), __file__, sys.version, *arguments]).encode(errors="surrogateescape")
    return f"{_KIND}{hashlib.sha256(key).hexdigest()[:16]}"


def _seen(line: str) -> str:
    """What of a path counts, without a blank in it."""
    kind, path = line[:1], line[1:]
    try:
        if kind in (_CONTENT, _DEFINITION):
            return _hash(path)
        if kind == _NAMES:
            names = sorted(name for name in os.listdir(path) if name != "__pycache__")
            return _hashed("\0".join(names).encode(errors="surrogateescape"))
        state = os.stat(path)
        return f"{state.st_size}.{state.st_mtime_ns}"
    except OSError:
        return "none"


def _hashed(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _hash(path: str) -> str:
    """Of a file. It is most of a check that nothing has changed for, and open() would add as much again."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        piece = os.read(descriptor, _PIECE)
        found = hashlib.sha256(piece)
        while len(piece) == _PIECE:
            piece = os.read(descriptor, _PIECE)
            found.update(piece)
        return found.hexdigest()
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
            f"{_CONTENT if name == 'package.xml' else _DEFINITION}{os.path.join(place, name)}"
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
