"""Renders Outputs, the planned files of targets, with templates that are compiled to Python."""

from __future__ import annotations

import functools
import hashlib
import marshal
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from shmgen.core import cache
from shmgen.core.model import Output

RENDERERS_MODULE = "shmgen.generator.renderers"


def render(outputs: Iterable[Output]) -> dict[str, str]:
    """Return the text of every output by path, sorted by path."""
    texts: dict[str, str] = {}
    for output in outputs:
        assert output.path not in texts, f"two outputs at {output.path}"
        if output.template.endswith(".j2"):
            texts[output.path] = _renderers()[output.template](output.view)
        else:  # a file that is copied unchanged, from this package or from the templates
            folder = Path(__file__).parents[2] if output.template.startswith("shmgen/") else template_folder()
            texts[output.path] = (folder / output.template).read_text(encoding="utf-8")
    return dict(sorted(texts.items()))


@functools.cache
def _renderers() -> Mapping[str, Callable[[Any], str]]:
    """Return the function that renders a template, for each template path.

    A wheel contains these functions. In a checkout, the templates are compiled first.
    """
    try:
        scope = vars(import_module(RENDERERS_MODULE))
    except ModuleNotFoundError:
        scope = {}
        exec(_compiled_templates(template_folder()), scope)
    return cast("Mapping[str, Callable[[Any], str]]", scope["PRINTERS"])


def _compiled_templates(templates: Path) -> Any:
    """Return the code object of the compiled templates, from the cache if no template has changed."""
    files = [Path(__file__).with_name("templates.py"), *sorted(templates.rglob("*.j2"))]
    states = [(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    name = f"templates-{hashlib.sha256(repr((sys.version, states)).encode()).hexdigest()[:16]}"
    bytecode = cache.read(name)
    if bytecode is None:
        # Imported here, because jinja2 takes longer to load than generating a message.
        from shmgen.generator.templates import compile_templates

        bytecode = marshal.dumps(compile(compile_templates(templates), str(templates), "exec"))
        cache.write(name, bytecode)
        cache.forget("templates-", 3)
    return marshal.loads(bytecode)


def template_folder() -> Path:
    """Return the folder of the templates: inside the package in a wheel, at the top level in a checkout."""
    installed = Path(__file__).parents[1] / "templates"
    return installed if installed.is_dir() else Path(__file__).parents[3] / "templates"
