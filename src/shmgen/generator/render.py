"""Turns Outputs into {path: text}: the only module that knows jinja2."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from pathlib import Path

import jinja2

from shmgen.core.model import Output

COMPILED = f"compiled-{jinja2.__version__}"
"""The folder below that of the templates with what a build has compiled of them, for this very Jinja."""


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


def compile_templates(folder: Path) -> None:
    """Writes what Jinja makes of all templates into `folder`, for a wheel."""
    _environment(False).compile_templates(str(folder), extensions=["j2"], zip=None, ignore_errors=False)


@functools.cache
def _environment(may_be_compiled: bool = True) -> jinja2.Environment:
    templates = template_folder()
    compiled = templates / COMPILED
    use_compiled = may_be_compiled and compiled.is_dir()
    return jinja2.Environment(
        loader=jinja2.ModuleLoader(compiled) if use_compiled else jinja2.FileSystemLoader(templates),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        auto_reload=False,  # nobody edits them within one run
        autoescape=False,  # targets hand over finished strings; what is printed is not HTML
    )


def template_folder() -> Path:
    """Beside the package in a wheel; in a checkout the folder at the top level."""
    installed = Path(__file__).parents[1] / "templates"
    return installed if installed.is_dir() else Path(__file__).parents[3] / "templates"
