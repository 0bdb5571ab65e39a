"""Cuts a message that is too long for its region: sequences lose their ends, and so do strings."""

from __future__ import annotations

from typing import Any

from shmgen.core.model import Layout, Layouts, Ref, Role, String
from shmgen.runtime import values
from shmgen.targets.python.names import python_member


def cut(message: Any, layout: Layout, layouts: Layouts) -> None:
    """Shortens what is too long, in place. Fixed arrays stay: one of another length is an error of its sender."""
    bounded = False
    for slot in layout.slots:
        if slot.role is not Role.DATA:  # there may be padding between a count and what it counts
            bounded = bounded or slot.role is Role.COUNT
            continue
        name = python_member(slot.name)
        value = getattr(message, name)
        if bounded and len(value) > (slot.count or 0):
            value = value[: slot.count]
            setattr(message, name, value)
        match slot.type:
            case Ref():
                for inner in [value] if slot.count is None else value:
                    cut(inner, layouts[slot.type.name], layouts)
            case String() if slot.count is None:
                setattr(message, name, _shortened(value, slot.type, layout))
            case String():
                setattr(message, name, [_shortened(text, slot.type, layout) for text in value])
            case _:
                pass
        bounded = False


def _shortened(text: str, string: String, layout: Layout) -> str:
    capacity = string.capacity or 0
    if string.wide:
        return values.wide_text_cut(text, capacity, "").decode("utf-16-le")
    if layout.options.encoding == "latin-1":
        return values.text_latin1_cut(text, capacity, "").decode("latin-1")
    return values.text_cut(text, capacity, "").decode()
