"""Turns Outputs into {path: text}: the only module that knows jinja2."""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterable
from pathlib import Path

from jinja2 import BytecodeCache, Environment, FileSystemLoader, StrictUndefined
from jinja2.bccache import Bucket

from shmgen.core import cache
from shmgen.core.model import Output


def render(outputs: Iterable[Output]) -> dict[str, str]:
    """The text of every output, by path, in sorted order."""
    texts: dict[str, str] = {}
    for output in outputs:
        assert output.path not in texts, f"two outputs at {output.path}"
        if output.template.endswith(".j2"):
            texts[output.path] = _environment().get_template(output.template).render(view=output.view)
        elif output.template.startswith("shmgen/"):  # of this package
            texts[output.path] = (Path(__file__).parents[2] / output.template).read_text(encoding="utf-8")
        else:  # written by hand
            texts[output.path] = (template_folder() / output.template).read_text(encoding="utf-8")
    return dict(sorted(texts.items()))


@functools.cache
def _environment() -> Environment:
    return Environment(
        loader=FileSystemLoader(template_folder()),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        auto_reload=False,  # nobody edits them within one run
        bytecode_cache=_Compiled(),
        autoescape=False,  # targets hand over finished strings; what is printed is not HTML
    )


class _Compiled(BytecodeCache):
    """Templates as Python has compiled them; Jinja itself finds those whose source is another by now."""

    def load_bytecode(self, bucket: Bucket) -> None:
        if (kept := cache.read(_name(bucket))) is not None:
            bucket.bytecode_from_string(kept)

    def dump_bytecode(self, bucket: Bucket) -> None:
        cache.write(_name(bucket), bucket.bytecode_to_string())


def _name(bucket: Bucket) -> str:
    return f"template-{bucket.key}-{sys.implementation.cache_tag}"


def template_folder() -> Path:
    """Beside the package in a wheel; in a checkout the folder at the top level."""
    installed = Path(__file__).parents[1] / "templates"
    return installed if installed.is_dir() else Path(__file__).parents[3] / "templates"
