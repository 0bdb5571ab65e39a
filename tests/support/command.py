"""Run the `shmgen` command in this process and return its exit code and output."""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from shmgen.cli import main

PRELOAD = """
import contextlib, difflib, importlib, os, pkgutil, sys
import shmgen
for found in pkgutil.walk_packages(shmgen.__path__, "shmgen."):
    if not found.name.startswith(("shmgen.__main__", "shmgen.bag", "shmgen.bridge", "shmgen.view")):
        with contextlib.suppress(ImportError):
            importlib.import_module(found.name)
"""
"""Imports modules that commands import late: after a change of the user, the process may not read the checkout."""


class Result(NamedTuple):
    code: int
    stdout: str
    stderr: str

    @property
    def sentence(self) -> str:
        """Return the errors without codes and line ends: `place: message; hint`."""
        return re.sub(r"\n  hint: ", "; ", re.sub(r"error\[SHM\d+\]: ", "", self.stderr))


def run(arguments: Sequence[str], folder: Path) -> Result:
    """Run `shmgen arguments…` in `folder`."""
    stdout, stderr = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
    with inside(folder), contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
        before, sys.argv = sys.argv, ["shmgen", *arguments]
        try:
            main.main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        finally:
            sys.argv = before
    printed = [stream.buffer.getvalue().decode() for stream in (stdout, stderr)]  # type: ignore[attr-defined]
    return Result(code, *printed)


@contextlib.contextmanager
def inside(folder: Path) -> Iterator[None]:
    before = os.open(".", os.O_RDONLY)  # its path may lead through a folder that the present user may not enter
    os.chdir(folder)
    try:
        yield
    finally:
        os.fchdir(before)
        os.close(before)


def tree(folder: Path) -> dict[str, bytes | None]:
    """Return the content of each file by path, and None for each folder."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }
