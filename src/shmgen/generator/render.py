"""Turns Outputs into {path: text}, with what the templates become in Python."""

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

BUILT = "shmgen.generator.printers"


def render(outputs: Iterable[Output]) -> dict[str, str]:
    """The text of every output, by path, in sorted order."""
    texts: dict[str, str] = {}
    for output in outputs:
        assert output.path not in texts, f"two outputs at {output.path}"
        if output.template.endswith(".j2"):
            texts[output.path] = _printers()[output.template](output.view)
        elif output.template.startswith("shmgen/"):  # of this package
            texts[output.path] = (Path(__file__).parents[2] / output.template).read_text(encoding="utf-8")
        else:  # written by hand
            texts[output.path] = (template_folder() / output.template).read_text(encoding="utf-8")
    return dict(sorted(texts.items()))


@functools.cache
def _printers() -> Mapping[str, Callable[[Any], str]]:
    """Of the module that a wheel brings; in a checkout, where templates change, what is made of them now."""
    try:
        scope = vars(import_module(BUILT))
    except ModuleNotFoundError:
        scope = {}
        exec(_compiled(template_folder()), scope)
    return cast("Mapping[str, Callable[[Any], str]]", scope["PRINTERS"])


def _compiled(templates: Path) -> Any:
    """The code of the module that they become, from the cache if they are those it was made of."""
    files = [Path(__file__).with_name("templates.py"), *sorted(templates.rglob("*.j2"))]
    states = [(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    name = f"templates-{hashlib.sha256(repr((sys.version, states)).encode()).hexdigest()[:16]}"
    kept = cache.read(name)
    if kept is None:
        from shmgen.generator.templates import compiled  # jinja2 takes longer to load than all that a message takes

        kept = marshal.dumps(compile(compiled(templates), str(templates), "exec"))
        cache.write(name, kept)
        cache.forget("templates-", 3)
    return marshal.loads(kept)


def template_folder() -> Path:
    """Beside the package in a wheel; in a checkout the folder at the top level."""
    installed = Path(__file__).parents[1] / "templates"
    return installed if installed.is_dir() else Path(__file__).parents[3] / "templates"
