"""Filters and formats samples for `shmgen echo`: whole messages or one field, as YAML, JSON or lines of CSV."""

from __future__ import annotations

import csv
import ctypes
import io
from collections.abc import Callable, Iterator
from typing import Any, Literal

from shmgen.core.escape import legible
from shmgen.runtime import Message
from shmgen.tools.messages import format, paths


class Printer:
    """Formats the samples of one topic for `shmgen echo`.

    The type of the samples may change, because a region may be recreated with another type.
    """

    def __init__(self, form: Literal["yaml", "json", "csv"], field: str | None, only: str | None, full: bool) -> None:
        """Store the samples and fields to print, and the output format `form`.

        * `only` is a condition such as `position.x > 1`, which a sample must fulfil. None prints all samples.
        * `field` is the path of the field to print. None prints the whole message.
        * `full` prints all elements of arrays in YAML. JSON and CSV always have all elements.
        """
        self._form, self._field, self._only = form, field, only
        self._most = None if full else format.SHORT
        self._kind: type[Message] | None = None
        self._titles = ""
        self._get: Callable[[Message], Any] = lambda message: message
        self._holds: Callable[[Message], bool] = lambda message: True

    def text(self, message: Message) -> str | None:
        """Return the text to print for a message, or None if there is nothing to print.

        There is nothing to print if the message does not fulfil the condition `only`. There is nothing to print either
        if `field` names an element that a sequence of this message does not have. Raises CountExceeded if a count is
        damaged, and ValueError if `field` or `only` is invalid for the type of the message.
        """
        if type(message) is not self._kind:
            self._take(type(message))
        if not self._holds(message) or (value := self._get(message)) is None:
            return None
        titles, self._titles = self._titles, ""
        return titles + self._format(value)

    def _take(self, kind: type[Message]) -> None:
        self._kind = kind
        if self._field:
            self._get = paths.getter(kind, self._field)
        if self._only:
            self._holds = paths.condition(kind, self._only)
        if self._form == "csv":
            self._titles = _csv_line(csv_titles(self._get(kind()), self._field or "")) + "\n"

    def _format(self, value: Any) -> str:
        if self._form == "csv":
            return _csv_line(csv_row(value))
        if self._form == "json":
            return format.as_json(value)
        return f"{format.yaml(value, self._most)}---"


def csv_titles(value: Any, within: str = "") -> list[str]:
    """Return the column titles of a value at the path `within`, such as `flags[0]`. A sequence is one column."""
    return [name for name, _ in _cells(value, within)]


def csv_row(value: Any) -> list[str]:
    """Return the values of one CSV line, one for each column, without control characters.

    Raises CountExceeded if the count of a sequence is damaged.
    """
    return [_text(cell) for _, cell in _cells(value, "")]


def _csv_line(cells: list[str]) -> str:
    """Join cells with commas, with quotes if needed."""
    out = io.StringIO()
    csv.writer(out, lineterminator="").writerow(cells)
    return out.getvalue()


def _cells(value: Any, within: str) -> Iterator[tuple[str, Any]]:
    match value:
        case Message():
            for step in value._steps_:
                name, inner = format.ros_name(step.name), format.field(value, step.name)
                if step.count_at >= 0:  # a sequence stays in one column, because its length changes
                    yield _below(within, name), inner
                else:
                    yield from _cells(inner, _below(within, name))
        case tuple() if hasattr(value, "_asdict"):
            for name, inner in value._asdict().items():
                yield _below(within, name), inner
        case ctypes.Array() | list():
            for index, inner in enumerate(format.elements(value)):
                yield from _cells(inner, f"{within}[{index}]")
        case _:
            yield within, value


def _below(within: str, name: str) -> str:
    return f"{within}.{name}" if within else name


def _text(value: Any) -> str:
    if isinstance(value, str):
        return legible(value)
    return format.as_json(value) if isinstance(value, (bool, ctypes.Array, list)) else repr(value)
