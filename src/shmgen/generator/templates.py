"""Compiles the templates to Python, which prints without Jinja: the only module that knows jinja2.

A template has text, `{{ dotted.name }}`, `for`, `if` on a name and `include`; each becomes a function of a view.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, nodes


def compiled(folder: Path) -> str:
    """A module with `PRINTERS`, a function of a view for each template of the folder, by its path there."""
    found = sorted(file.relative_to(folder).as_posix() for file in folder.rglob("*.j2"))
    lines = ["PRINTERS = {}"]
    for path in found:
        lines += ["def printer(view):", " out = []", " add = out.append"]
        lines += _printed(_parsed(folder, path), folder, {"view": "view"}, " ")
        lines += [" return ''.join(out)", f"PRINTERS[{path!r}] = printer"]
    return "\n".join(lines) + "\n"


def _parsed(folder: Path, path: str) -> list[nodes.Node]:
    """What is printed is not HTML; views hold finished strings."""
    environment = Environment(trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, autoescape=False)
    return environment.parse((folder / path).read_text(encoding="utf-8"), filename=path).body


def _printed(body: Iterable[nodes.Node], folder: Path, names: Mapping[str, str], indent: str) -> Iterator[str]:
    """Lines of Python; `names` are those of the template, with what they are called there."""
    for node in body:
        match node:
            case nodes.Output():
                pieces = "".join(_piece(part, names) for part in node.nodes)
                yield f"{indent}add(f'{pieces}')"
            case nodes.For(target=nodes.Name(name=name)) if not node.else_:
                inner = f"{name}_{len(indent)}"  # a loop within may have the same name
                yield f"{indent}for {inner} in {_value(node.iter, names)}:"
                yield from _printed(node.body, folder, {**names, name: inner}, f"{indent} ")
            case nodes.If() if not node.elif_:
                yield f"{indent}if {_value(node.test, names)}:"
                yield from _printed(node.body, folder, names, f"{indent} ")
                if node.else_:
                    yield f"{indent}else:"
                    yield from _printed(node.else_, folder, names, f"{indent} ")
            case nodes.Include(template=nodes.Const(value=str(path))):
                yield from _printed(_parsed(folder, path), folder, names, indent)
            case _:
                raise ValueError(f"a template holds {node}")


def _piece(node: Any, names: Mapping[str, str]) -> str:
    """Of an f-string in single quotes."""
    if isinstance(node, (nodes.TemplateData, nodes.Const)):
        text = node.data if isinstance(node, nodes.TemplateData) else str(node.value)
        return (
            f"'{text}"[1:].encode("unicode_escape").decode().replace("'", "\\'").replace("{", "{{").replace("}", "}}")
        )
    return f"{{{_value(node, names)}!s}}"


def _value(node: Any, names: Mapping[str, str]) -> str:
    match node:
        case nodes.Name(name=name):
            return names.get(name, name)  # another one is of whoever includes this
        case nodes.Getattr():
            return f"{_value(node.node, names)}.{node.attr}"
        case _:
            raise ValueError(f"a template holds {node}")
