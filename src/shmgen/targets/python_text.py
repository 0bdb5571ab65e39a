"""Turns the user's words into Python text that stays where it is printed: docstrings and literals."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.model import Default, Message, ros_type


def documentation(message: Message) -> Iterator[str]:
    """The rest of the comment's first paragraph, the fields with shape, bound and unit, and the definition."""
    yield from in_docstring(message.doc).partition("\n\n")[0].split("\n")[1:]
    fields = message.fields
    if fields:
        yield from ("", "Fields:")
    for field in fields:
        unit = f" [{field.unit}]" if field.unit else ""
        doc = in_docstring(field.doc.partition("\n")[0])
        yield f"    {field.name} ({ros_type(field.type)}){unit}" + (f": {doc}" if doc else "")
    text = in_docstring(message.text).strip("\n")
    if text.strip():
        yield from ("", "Definition::", "")
        yield from (f"    {line}".rstrip() for line in text.split("\n"))


def in_docstring(text: str) -> str:
    """Text that cannot end the docstring it stands in, nor begin an escape."""
    cleaned = "".join(char if char == "\n" or char.isprintable() else " " for char in text)
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
