"""Turns what generated code imports of shmgen into files of the generated package, so that a robot needs no shmgen."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import resources

from shmgen.model import Output

FOLDER = "_beside"
"""Below the generated package, and no package itself: it goes behind all else on Python's path."""
FILES = ("__init__.py", "abi.py", "wording.py", "py.typed")


def plan(root: str) -> Iterator[Output]:
    """`<root>/_beside/shmgen/…`, in Python alone, and a README.txt with its licence."""
    package = resources.files("shmgen")
    names = sorted(entry.name for entry in (package / "runtime").iterdir() if entry.name.endswith(".py"))
    for path in (*FILES, *(f"runtime/{name}" for name in names)):
        yield Output(f"{root}/{FOLDER}/shmgen/{path}", f"shmgen/{path}", None)
    yield Output(f"{root}/{FOLDER}/shmgen/README.txt", "python/beside.txt", None)
