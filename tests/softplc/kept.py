"""Keeps what takes long to make, blark's trees and compiled programs, in the virtual environment that tests run in.

Without such an environment nothing is kept. What nobody asked for in a week is removed.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import time
from pathlib import Path

FOLDER = Path(sys.prefix) / "softplc" if sys.prefix != sys.base_prefix else None
_WEEK = 7 * 24 * 3600


def key(*parts: str | bytes) -> str:
    """A name for what is made of `parts` and nothing else."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()


def find(name: str) -> bytes | None:
    """What was kept under `name`."""
    if FOLDER is None:
        return None
    try:
        data = (FOLDER / name).read_bytes()
        os.utime(FOLDER / name)
    except OSError:  # not there, or of another user
        return None
    return data


def keep(name: str, data: bytes) -> None:
    """From now on `find` has it, in every process; whoever comes at the same time keeps the same."""
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


def tidy() -> None:
    """Removes what is old."""
    old = time.time() - _WEEK
    for file in FOLDER.iterdir() if FOLDER is not None and FOLDER.is_dir() else ():
        try:
            if file.stat().st_mtime < old:
                file.unlink()
        except OSError:  # another process was first
            continue
