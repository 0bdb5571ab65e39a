"""The extension of shmgen in C under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sysconfig
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from . import REPOSITORY, kept


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

    Objects of unchanged files come from the cache, because a planted fault changes one file of four.
    With LD_PRELOAD and these options, the sanitizers also work in a Python that was built without them.
    """
    if not shutil.which("gcc"):
        pytest.skip("gcc is not installed")
    hook: Any = build_hook()
    sources = sources or hook.SOURCES
    hook.write_header(folder)
    compiler = ["gcc", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", *hook.FLAGS]
    include = [f"-I{path}" for path in (sysconfig.get_path("include"), hook.HEADERS, folder)]
    headers = [*hook.HEADERS.glob("*.h"), *sources.rglob("*.h"), folder / "shmgen.h"]
    key = kept.key(*compiler, *(header.read_bytes() for header in sorted(headers, key=lambda header: header.name)))
    objects = []
    for name in hook.RUNTIME["_core.abi3.so"]:
        source, compiled = sources / name, folder / f"{Path(name).stem}.o"
        command = [*compiler, *include, "-c", source, "-o", compiled]
        cached = f"sanitized-{kept.key(key, name, source.read_bytes())}"
        kept.find_or_create(cached, compiled, partial(subprocess.run, command, check=True))
        objects.append(compiled)
    subprocess.run([*compiler, "-shared", *objects, "-o", folder / "_core.abi3.so"], check=True)
    library = subprocess.run(["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True).stdout
    options = {"LD_PRELOAD": library.strip(), "ASAN_OPTIONS": "detect_leaks=0", "PYTHONMALLOC": "malloc"}
    return os.environ | options
