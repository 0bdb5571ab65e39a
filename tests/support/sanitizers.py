"""The extension of shmgen in C under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sysconfig
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.softplc import kept

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

    Objects of unchanged files come from the cache, because a planted fault changes one file of four.
    With LD_PRELOAD and these options, the sanitizers also work in a Python that was built without them.
    """
    if not shutil.which("gcc"):
        pytest.skip("gcc is not installed")
    hook: Any = build_hook()
    sources = sources or hook.SOURCES
    hook.print_header(folder)
    folders = (sysconfig.get_path("include"), hook.HEADERS, folder)
    compiler = ["gcc", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", *hook.FLAGS]
    headers = [*Path(hook.HEADERS).glob("*.h"), *sources.rglob("*.h"), folder / "shmgen.h"]
    key = kept.key(*compiler, *(header.read_bytes() for header in sorted(headers, key=lambda header: header.name)))
    objects = []
    for source in hook.RUNTIME["_core.abi3.so"]:
        objects.append(folder / f"{Path(source).stem}.o")
        name = f"sanitized-{kept.key(key, source, (sources / source).read_bytes())}"
        with kept.locked(name):
            if (compiled := kept.find(name)) is not None:
                objects[-1].write_bytes(compiled)
                continue
            include = [f"-I{path}" for path in folders]
            subprocess.run([*compiler, *include, "-c", sources / source, "-o", objects[-1]], check=True)
            kept.keep(name, objects[-1].read_bytes())
    subprocess.run([*compiler, "-shared", *objects, "-o", folder / "_core.abi3.so"], check=True)
    library = subprocess.run(["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True).stdout
    options = {"LD_PRELOAD": library.strip(), "ASAN_OPTIONS": "detect_leaks=0", "PYTHONMALLOC": "malloc"}
    return os.environ | options
