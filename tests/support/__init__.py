"""Helpers that several tests share."""

from __future__ import annotations

import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).parents[2]
SHARED = REPOSITORY.parent / "shared"


def import_or_skip(name: str, *, reason: str = "") -> Any:
    """Import a third party's module. Whatever exception its import raises, skip the test or file with the cause.

    `reason` is printed if the module is not installed. pytest's own `importorskip` stops at any exception but a
    ModuleNotFoundError: GitPython, for one, raises an ImportError on a machine without git.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return import_module(name)
    except Exception as error:
        is_absent = isinstance(error, ModuleNotFoundError) and error.name == name.partition(".")[0]
        cause = next(iter(str(error).strip().splitlines()), "")
        broken = f"{name} cannot be imported: {type(error).__name__}: {cause}"
        import pytest  # the programs of tests import this package, and start faster without pytest

        pytest.skip((reason or f"no {name}: pip install {name}") if is_absent else broken, allow_module_level=True)
