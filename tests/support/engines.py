"""Use the reference engine in Python for a part of a test."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from shmgen.runtime import engine, reference

NAMES = ("Writer", "Reader", "Notifier", "sleep_any", "can_wait_for_many")


def become_python() -> None:
    """Use the Python engine in the rest of this process and in its child processes."""
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
