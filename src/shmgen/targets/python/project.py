"""The pyproject.toml that makes the generated Python installable."""

from __future__ import annotations

from typing import NamedTuple

from shmgen.core.model import Output


class Project(NamedTuple):
    name: str
    version: str
    package: str
    needs: str


def plan(distribution: str, package: str, beside: bool) -> Output:
    """`python/pyproject.toml`; `distribution` is such as `robot-shm 1.2.0`; `beside`: the runtime comes along."""
    name, _, version = distribution.partition(" ")
    return Output(
        "python/pyproject.toml",
        "python/pyproject.toml.j2",
        Project(name, version, package, "posix_ipc>=1.1" if beside else "shmgen"),
    )
