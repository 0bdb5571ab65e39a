"""The `shmgen` command as a user has it, in this process: its exit code, what it printed, what it did to a folder."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from shmgen.cli import main


class Result(NamedTuple):
    code: int
    stdout: str
    stderr: str


def run(arguments: Sequence[str], folder: Path) -> Result:
    """`shmgen arguments…` in `folder`."""
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
    """Every file with its content and every folder with None, by path."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }
