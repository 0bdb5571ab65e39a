"""Find the layout.lock in a file, a folder or a git revision."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from shmgen.core import files
from shmgen.core.diagnostics import Diagnostic, Rejected, Span
from shmgen.drift import lockfile


def lock(name: str, output: Path) -> tuple[lockfile.Lock, str]:
    """Find and parse the layout.lock in a file, folder or git revision `name`. Also return its name for diagnostics.

    A revision is searched for the layout.lock of the folder `output`. Raises Rejected if the file is missing (SHM001)
    or damaged (SHM408).
    """
    file = Path(name, lockfile.LOCK) if os.path.isdir(name) else Path(name)
    if file.exists():
        place = str(file)
        try:
            text = files.read_file(file).decode(errors="replace")
        except OSError as error:
            raise _rejected_error(f"cannot read: {error.strerror}", place) from None
    else:
        place = f"{name}:{output / lockfile.LOCK}"
        text = _of_revision(name, output / lockfile.LOCK)
    return lockfile.read(text, place), place


def _of_revision(revision: str, file: Path) -> str:
    path = os.path.relpath(file).replace(os.sep, "/")
    place = "" if path.startswith("..") else "./"
    try:
        command = ["git", "show", "--end-of-options", f"{revision}:{place}{path}"]
        done = subprocess.run(command, capture_output=True, check=False)
    except OSError:
        raise _rejected_error("no such file, and git is not installed", revision) from None
    if done.returncode != 0:
        reason = done.stderr.decode(errors="replace").strip().removeprefix("fatal: ").partition("\n")[0]
        hint = "give a layout.lock, its folder, or a git revision; with a revision, -o gives the folder of the lock"
        raise _rejected_error(f"no such file, and git reports: {reason}", revision, hint)
    return done.stdout.decode(errors="replace")


def _rejected_error(message: str, place: str, hint: str = "") -> Rejected:
    return Rejected([Diagnostic("SHM001", message, Span(place), hint=hint)])
