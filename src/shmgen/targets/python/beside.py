"""Copies what generated code imports of shmgen into the generated package, so that a robot needs no shmgen."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from shmgen.core.model import Output

FOLDER = "_beside"
"""Below the generated package, and no package itself: it goes behind all else on Python's path."""
CORE = ("__init__.py", "abi.py", "escape.py", "plural.py")
"""Of `shmgen/core`: what the runtime imports."""


def plan(root: str) -> Iterator[Output]:
    """`<root>/_beside/shmgen/…`, in Python alone, and a README.txt with its licence."""
    package = Path(__file__).parents[2]
    runtime = sorted(file.relative_to(package).as_posix() for file in (package / "runtime").rglob("*.py"))
    for path in ("__init__.py", "py.typed", *(f"core/{name}" for name in CORE), *runtime):
        yield Output(f"{root}/{FOLDER}/shmgen/{path}", f"shmgen/{path}", None)
    yield Output(f"{root}/{FOLDER}/shmgen/README.txt", "python/beside.txt", None)
