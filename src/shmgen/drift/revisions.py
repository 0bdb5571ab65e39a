"""Finds the layout.lock that a file, a folder or a git revision holds."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from shmgen.core import files
from shmgen.core.diagnostics import Report, Span
from shmgen.drift import lockfile


def lock(name: str, output: Path) -> tuple[lockfile.Lock, str]:
    """The lock, and what diagnostics call it; of a revision that in `output`. Raises Rejected: SHM001, SHM408."""
    report = Report()
    file = Path(name, lockfile.LOCK) if os.path.isdir(name) else Path(name)
    if file.exists():
        shown = str(file)
        try:
            text = files.content(file).decode(errors="replace")
        except OSError as error:
            report.error("SHM001", f"cannot read: {error.strerror}", Span(shown))
            report.stop_if_any()
            raise
    else:
        shown = f"{name}:{output / lockfile.LOCK}"
        text = _of_revision(name, output / lockfile.LOCK, report)
    found = lockfile.read(text, shown, report)
    report.stop_if_any()
    return found, shown


def _of_revision(revision: str, file: Path, report: Report) -> str:
    path = os.path.relpath(file).replace(os.sep, "/")
    place = "" if path.startswith("..") else "./"
    try:
        command = ["git", "show", "--end-of-options", f"{revision}:{place}{path}"]
        done = subprocess.run(command, capture_output=True, check=False)
    except OSError:
        report.error("SHM001", "no such file, and there is no git", Span(revision))
    else:
        if done.returncode == 0:
            return done.stdout.decode(errors="replace")
        reason = done.stderr.decode(errors="replace").strip().removeprefix("fatal: ").partition("\n")[0]
        hint = "give a layout.lock, the folder it is in, or a git revision; -o says where it is in that"
        report.error("SHM001", f"no such file, and git says: {reason}", Span(revision), hint=hint)
    report.stop_if_any()
    raise AssertionError
