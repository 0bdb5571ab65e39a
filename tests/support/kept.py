"""Caches the results of slow steps, the trees of blark and compiled programs, in the virtual environment of the tests.

Without a virtual environment nothing is cached. Entries that were not used for a week are removed.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

FOLDER = Path(sys.prefix) / "softplc" if sys.prefix != sys.base_prefix else None
_WEEK = 7 * 24 * 3600


def key(*parts: str | bytes) -> str:
    """Return a name for a result that depends only on `parts`."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()


def find(name: str) -> bytes | None:
    """Return the data that was cached under `name`, or None."""
    if FOLDER is None:
        return None
    try:
        data = (FOLDER / name).read_bytes()
        os.utime(FOLDER / name)
    except OSError:  # not there, or of another user
        return None
    return data


def keep(name: str, data: bytes) -> None:
    """Write data to the cache under `name` for all processes. Processes that cache the same name have the same data."""
    if FOLDER is None:
        return
    try:
        if not FOLDER.is_dir():
            FOLDER.mkdir()
        with tempfile.NamedTemporaryFile(dir=FOLDER, delete=False) as file:
            file.write(data)
        os.replace(file.name, FOLDER / name)
    except OSError:  # somebody else's environment, or a full disk
        return


def find_or_create(name: str, file: Path, create: Callable[[], object]) -> None:
    """Write the data cached under `name` to `file`. If there is none, `create` writes `file`, which is then cached."""
    with cache_locked(name):
        if (data := find(name)) is not None:
            file.write_bytes(data)
        else:
            create()
            keep(name, file.read_bytes())
            tidy()


@contextmanager
def cache_locked(name: str) -> Iterator[None]:
    """Hold a lock of the cache, so that two processes do not create the same data at the same time."""
    with ExitStack() as stack:
        if FOLDER is not None:
            with suppress(OSError):  # somebody else's environment, or a full disk
                stack.enter_context(locked(FOLDER / f"{name}.lock"))
        yield


@contextmanager
def locked(file: Path) -> Iterator[None]:
    """Hold a lock on `file`, which is created with its folder. Other processes wait until the lock is released."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def tidy() -> None:
    """Remove old entries of the cache."""
    old = time.time() - _WEEK
    for file in FOLDER.iterdir() if FOLDER is not None and FOLDER.is_dir() else ():
        try:
            if file.stat().st_mtime < old:
                file.unlink()
        except OSError:  # another process was first
            continue
