"""Messages as lines of a table: one value a column, for spreadsheets and plots."""

from __future__ import annotations

import csv
import ctypes
import io
from collections.abc import Iterator
from typing import Any

from shmgen.core.escape import legible
from shmgen.runtime import Message
from shmgen.tools.messages.format import as_line, ros_name, spelled, tree_of


def titles(value: Any, within: str = "") -> list[str]:
    """What _cells() gives of such a value: `position.x`, `flags[0]`; of a sequence one title."""
    return [name for name, _ in _cells(value, within)]


def row(value: Any) -> list[str]:
    """Nothing in it is obeyed by a terminal. Raises CountExceeded."""
    return [_text(cell) for _, cell in _cells(value, "")]


def line(cells: list[str]) -> str:
    """With commas, and quotes where they are needed."""
    out = io.StringIO()
    csv.writer(out, lineterminator="").writerow(cells)
    return out.getvalue()


def _cells(value: Any, within: str) -> Iterator[tuple[str, Any]]:
    match value:
        case Message():
            for member in value._names_:
                name = ros_name(member)
                inner, fixed = getattr(value, member), _is_fixed(value, member)
                if isinstance(inner, (ctypes.Array, list)) and not fixed:
                    yield _below(within, name), inner
                else:
                    yield from _cells(inner, _below(within, name))
        case tuple() if hasattr(value, "_asdict"):
            for name, inner in value._asdict().items():
                yield _below(within, name), inner
        case ctypes.Array() | list():
            for index, inner in enumerate(value):
                yield from _cells(inner, f"{within}[{index}]")
        case _:
            yield within, value


def _is_fixed(message: Message, member: str) -> bool:
    """Whether it always has as many elements: a sequence has a count, and stays in one column."""
    return getattr(type(message).__dict__.get(member), "count_at", None) is None


def _below(within: str, name: str) -> str:
    return f"{within}.{name}" if within else name


def _text(value: Any) -> str:
    if isinstance(value, str):
        return legible(value)
    if isinstance(value, (ctypes.Array, list)):
        return as_line(spelled(tree_of(value, None)))
    return repr(value).lower() if isinstance(value, bool) else repr(value)
