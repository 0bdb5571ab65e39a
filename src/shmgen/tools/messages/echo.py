"""What `shmgen echo` prints of samples: all or one field, if they are wanted at all."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from shmgen.runtime import Message
from shmgen.tools.messages import csv, format, paths


class Printer:
    """For the samples of one topic, whose type may be another one when its region is made anew."""

    def __init__(self, form: Literal["yaml", "json", "csv"], field: str | None, only: str | None, full: bool) -> None:
        """`full`: of arrays all elements; JSON and CSV have them anyway."""
        self._form, self._field, self._only = form, field, only
        self._most = None if full else format.SHORT
        self._kind: type[Message] | None = None
        self._titles = ""
        self._get: Callable[[Message], Any] = lambda message: message
        self._holds: Callable[[Message], bool] = lambda message: True

    def text(self, message: Message) -> str | None:
        """None for one that is not wanted. Raises CountExceeded, and ValueError for a wrong path or condition."""
        if type(message) is not self._kind:
            self._take(type(message))
        if not self._holds(message) or (value := self._get(message)) is None:
            return None
        titles, self._titles = self._titles, ""
        return titles + self._shown(value)

    def _take(self, kind: type[Message]) -> None:
        self._kind = kind
        if self._field:
            self._get = paths.getter(kind, self._field)
        if self._only:
            self._holds = paths.condition(kind, self._only)
        if self._form == "csv":
            self._titles = csv.line(csv.titles(self._get(kind()), self._field or "")) + "\n"

    def _shown(self, value: Any) -> str:
        if self._form == "csv":
            return csv.line(csv.row(value))
        if self._form == "json":
            return format.as_line(format.spelled(format.tree_of(value, None)))
        text = format.value_as_yaml(value, self._most)
        return f"{text}---"
