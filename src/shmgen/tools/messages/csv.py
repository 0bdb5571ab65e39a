"""Formats messages as lines of CSV, for spreadsheets and plots: one value in each column."""

from __future__ import annotations

import csv
import ctypes
import io
from collections.abc import Iterator
from typing import Any

from shmgen.core.escape import legible
from shmgen.runtime import Message
from shmgen.tools.messages.format import as_json, elements, field, ros_name


def titles(value: Any, within: str = "") -> list[str]:
    """Return the column titles of a value at the path `within`, such as `flags[0]`. A sequence is one column."""
    return [name for name, _ in _cells(value, within)]


def row(value: Any) -> list[str]:
    """Return the values of one CSV line, one for each column, without control characters.

    Raises CountExceeded if the count of a sequence is damaged.
    """
    return [_text(cell) for _, cell in _cells(value, "")]


def line(cells: list[str]) -> str:
    """Join cells with commas, with quotes if needed."""
    out = io.StringIO()
    csv.writer(out, lineterminator="").writerow(cells)
    return out.getvalue()


def _cells(value: Any, within: str) -> Iterator[tuple[str, Any]]:
    match value:
        case Message():
            for step in value._steps_:
                name, inner = ros_name(step.name), field(value, step.name)
                if step.count_at >= 0:  # a sequence stays in one column, because its length changes
                    yield _below(within, name), inner
                else:
                    yield from _cells(inner, _below(within, name))
        case tuple() if hasattr(value, "_asdict"):
            for name, inner in value._asdict().items():
                yield _below(within, name), inner
        case ctypes.Array() | list():
            for index, inner in enumerate(elements(value)):
                yield from _cells(inner, f"{within}[{index}]")
        case _:
            yield within, value


def _below(within: str, name: str) -> str:
    return f"{within}.{name}" if within else name


def _text(value: Any) -> str:
    if isinstance(value, str):
        return legible(value)
    if isinstance(value, (ctypes.Array, list)):
        return as_json(value)
    return repr(value).lower() if isinstance(value, bool) else repr(value)
