"""Shortcuts from messages to layouts, files, imported classes and compiled headers."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from shmgen import config
from shmgen.config.entries import Bounds
from shmgen.core.diagnostics import Report
from shmgen.core.model import Layouts, Schema, TypeName, TypeOptions
from shmgen.generator import bounds, layout, pipeline
from shmgen.targets import TARGETS, Job

from . import REPOSITORY

MAX_REGION = 2**26


def layouts_of(schema: Schema, options: TypeOptions | None = None) -> Layouts:
    bounded = bounds.apply(schema, Bounds({}, {}), Report())
    return layout.lay_out(bounded, options or TypeOptions(), MAX_REGION, Report())


def texts_of(layouts: Layouts, key: str, package: str = "shm_msgs") -> dict[str, str]:
    """Return the files that the target `key` generates, by path."""
    return pipeline.render_targets(TARGETS, [key], Job(layouts, package), Report())


@cache
def committed_texts() -> dict[str, str]:
    """Return everything that `make generated` writes; git has only the files that a person opens."""
    settings = config.load(REPOSITORY / "shmgen.toml", "shmgen.toml", Report())
    return pipeline.generate(settings, settings.messages)


def put(texts: Mapping[str, str], folder: Path) -> None:
    for path, text in texts.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


def module(folder: Path, package: str, name: TypeName) -> ModuleType:
    """Import the module with a message's classes, from a package in `folder`/python."""
    root = str(folder / "python")
    if sys.path[0] != root:
        sys.path.insert(0, root)
    known = sys.modules.get(package)
    if known is not None and folder / "python" / package not in map(Path, known.__path__):
        forget(package)  # another test had it from elsewhere
    importlib.invalidate_caches()
    return importlib.import_module(f"{package}.{name.package}.{name.kind}")


def forget(package: str) -> None:
    """Remove a package from sys.modules, so that the next import reads its files again."""
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        del sys.modules[name]


def classes(folder: Path, package: str, name: TypeName) -> tuple[Any, Any, Any]:
    """Return the message class, its publisher and its subscriber."""
    generated = module(folder, package, name)
    return tuple(getattr(generated, name.name + role) for role in ("", "Publisher", "Subscriber"))  # type: ignore[return-value]


def compile_headers(folder: Path, language: str = "c") -> None:
    """Compile all headers below `folder`/c in one translation unit, with their static assertions."""
    headers = sorted(path.relative_to(folder / "c") for path in (folder / "c").rglob("*.h"))
    source = "".join(f'#include "{header}"\n' for header in headers) + "int main(void) { return 0; }\n"
    standard = {"c": "-std=c11", "c++": "-std=c++17"}[language]
    command = [
        {"c": "gcc", "c++": "g++"}[language],
        f"-x{language}",
        standard,
        "-Wall",
        "-Wextra",
        "-Wpadded",
        "-Werror",
        "-pedantic",
    ]
    result = subprocess.run(
        [*command, f"-I{folder / 'c'}", "-fsyntax-only", "-"], input=source, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr[:4000]
