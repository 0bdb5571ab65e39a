"""Convert the user's text to docstrings and literals that cannot change the surrounding Python code."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from shmgen.core.model import Default, Message, ros_type

_RUFF_WIDTH = 88
"""The default line length of ruff and black, in characters."""


def documentation(message: Message) -> Iterator[str]:
    """Yield the lines of a generated class's docstring, except its first line.

    The lines are the rest of the first paragraph of the message's comment, the fields with type and unit, and the text
    of the definition.
    """
    yield from in_docstring(message.doc).partition("\n\n")[0].split("\n")[1:]
    fields = message.fields
    if fields:
        yield from ("", "Fields:")
    for field in fields:
        unit = f" [{field.unit}]" if field.unit else ""
        first, *others = field.doc.split("\n")
        yield in_docstring(f"    {field.name} ({ros_type(field.type)}){unit}" + (f": {first}" if first else ""))
        yield from (in_docstring(f"        {line}".rstrip()) for line in others)
    text = in_docstring(message.text).strip("\n")
    if text.strip():
        yield from ("", "Definition::", "")
        yield from (f"    {line}".rstrip() for line in text.split("\n"))


def in_docstring(text: str) -> str:
    """Escape text that would end the surrounding docstring or begin an escape sequence."""
    cleaned = "".join(char if char.isprintable() or char == "\n" else " " for char in text)
    return cleaned.replace("\\", "\\\\").replace('"', '\\"' if '"""' in cleaned or cleaned.endswith('"') else '"')


def literal(value: Default) -> str:
    match value:
        case tuple():
            return "(" + ", ".join(map(literal, value)) + (",)" if len(value) == 1 else ")")
        case str():
            return '"' + value.encode("unicode_escape").decode("ascii").replace('"', '\\"') + '"'
        case float() if value != value or value in (float("inf"), float("-inf")):
            return f'float("{value}")'
        case _:
            return repr(value)


def import_lines(module: str, names: Sequence[str]) -> list[str]:
    """Return import lines, wrapped in the style of ruff and black."""
    line = f"from {module} import {', '.join(names)}"
    return [line] if len(line) <= _RUFF_WIDTH else [f"from {module} import (", *(f"    {name}," for name in names), ")"]


def sort_key(name: str) -> tuple[bool, bool, list[tuple[bool, int, str]]]:
    """Return a key for the order in which ruff sorts modules and `__all__`.

    The order is constants, classes, other names. Numbers sort by value: 8 before 16.
    """
    parts = [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", name) if part]
    return not name.isupper(), not name[0].isupper(), parts
