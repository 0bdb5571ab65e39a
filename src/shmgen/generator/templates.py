"""Compiles the templates to Python functions that render without Jinja. Only this module imports jinja2.

A template contains text, `{{ dotted.name }}`, `for`, `if` on a name and `include`. The compiled
function takes the data for the template, an object named `view`, and returns the text.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, nodes


def compile_templates(folder: Path) -> str:
    """Return the source of a module whose dict `PRINTERS` maps each template's path to its render function."""
    paths = sorted(file.relative_to(folder).as_posix() for file in folder.rglob("*.j2"))
    lines = ["PRINTERS = {}"]
    for path in paths:
        lines += ["def printer(view):", " out = []", " add = out.append"]
        lines += _compile_nodes(_parse(folder, path), folder, {"view": "view"}, " ")
        lines += [" return ''.join(map(str, out))", f"PRINTERS[{path!r}] = printer"]
    return "\n".join(lines) + "\n"


def _parse(folder: Path, path: str) -> list[nodes.Node]:
    """Parse a template.

    Autoescape is off, because the output is not HTML and the data for a template consists of finished strings.
    """
    environment = Environment(trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, autoescape=False)
    return environment.parse((folder / path).read_text(encoding="utf-8"), filename=path).body


def _compile_nodes(body: Iterable[nodes.Node], folder: Path, names: Mapping[str, str], indent: str) -> Iterator[str]:
    """Yield the lines of Python that render a part of a template, given as the nodes in `body`.

    `names` maps the names of variables in the template to their names in the Python code.
    """
    for node in body:
        match node:
            case nodes.Output():
                yield from (f"{indent}add({_value(part, names)})" for part in node.nodes)
            case nodes.For(target=nodes.Name(name=name)) if not node.else_:
                inner = f"{name}_{len(indent)}"  # an inner loop may use the same name
                yield f"{indent}for {inner} in {_value(node.iter, names)}:"
                yield from _compile_nodes(node.body, folder, {**names, name: inner}, f"{indent} ")
            case nodes.If() if not node.elif_:
                yield f"{indent}if {_value(node.test, names)}:"
                yield from _compile_nodes(node.body, folder, names, f"{indent} ")
                if node.else_:
                    yield f"{indent}else:"
                    yield from _compile_nodes(node.else_, folder, names, f"{indent} ")
            case nodes.Include(template=nodes.Const(value=str(path))):
                yield from _compile_nodes(_parse(folder, path), folder, names, indent)
            case _:
                raise ValueError(f"a template holds {node}")


def _value(node: Any, names: Mapping[str, str]) -> str:
    """Return the Python expression for a text, a name or an attribute in a template."""
    match node:
        case nodes.TemplateData(data=text) | nodes.Const(value=str(text)):
            return repr(text)
        case nodes.Name(name=name):
            return names.get(name, name)  # an unknown name belongs to the including template
        case nodes.Getattr():
            return f"{_value(node.node, names)}.{node.attr}"
        case _:
            raise ValueError(f"a template holds {node}")
