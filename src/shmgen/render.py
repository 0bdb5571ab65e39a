"""Turns Outputs into {path: text}: the only module that knows jinja2."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from pathlib import Path

from jinja2 import Environment, FileSystemBytecodeCache, FileSystemLoader, StrictUndefined

from shmgen import cache
from shmgen.model import Output


def render(outputs: Iterable[Output]) -> dict[str, str]:
    """The text of every output, by path, in sorted order."""
    texts: dict[str, str] = {}
    for output in outputs:
        assert output.path not in texts, f"two outputs at {output.path}"
        if output.template.endswith(".j2"):
            texts[output.path] = _environment().get_template(output.template).render(view=output.view)
        else:  # written by hand
            texts[output.path] = (template_folder() / output.template).read_text(encoding="utf-8")
    return dict(sorted(texts.items()))


@functools.cache
def _environment() -> Environment:
    kept = cache.folder()
    return Environment(
        loader=FileSystemLoader(template_folder()),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        bytecode_cache=FileSystemBytecodeCache(kept) if kept else None,
        autoescape=False,  # targets hand over finished strings; what is printed is not HTML
    )


def template_folder() -> Path:
    """Beside the package in a wheel; in a checkout the folder at the top level."""
    installed = Path(__file__).parent / "templates"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "templates"
