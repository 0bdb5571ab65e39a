"""The extension of shmgen in C under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from . import REPOSITORY


def build_hook() -> ModuleType:
    """Return the repository's hatch_build.py as a new module."""
    spec = importlib.util.spec_from_file_location("hatch_build", REPOSITORY / "hatch_build.py")
    assert spec
    assert spec.loader
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    return hook


def environment(folder: Path, sources: Path | None = None) -> dict[str, str]:
    """Compile the extension, from `sources` if given, into `folder`. Return the environment for a Python that loads it.

    With LD_PRELOAD and these options, the sanitizers also work in a Python that was built without them.
    """
    if not shutil.which("gcc"):
        pytest.skip("gcc is not installed")
    hook: Any = build_hook()
    hook.SOURCES = sources or hook.SOURCES
    with pytest.MonkeyPatch.context() as there:
        there.setenv("CC", "gcc -g -fsanitize=address,undefined -fno-sanitize-recover=all")
        assert hook.build_extension(folder / "_core.abi3.so") == ""
    library = subprocess.run(["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True).stdout
    options = {"LD_PRELOAD": library.strip(), "ASAN_OPTIONS": "detect_leaks=0", "PYTHONMALLOC": "malloc"}
    return os.environ | options
