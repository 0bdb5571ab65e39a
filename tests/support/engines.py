"""Lets publishers and subscribers of a stretch of a test be of the reference in Python."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from shmgen.runtime import engine, reference

NAMES = ("Writer", "Reader", "sleep_any", "can_wait_for_many")


def become_python() -> None:
    """For the rest of this process, and in those that it starts."""
    for name in NAMES:
        setattr(engine, name, getattr(reference, name))
    engine.IN_C = False
    os.environ["SHMGEN_PURE"] = "1"


def use_python(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        monkeypatch.setattr(engine, name, getattr(reference, name))
    monkeypatch.setattr(engine, "IN_C", False)


@contextmanager
def in_python() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        use_python(patched)
        yield
