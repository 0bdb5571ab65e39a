"""Filters and formats samples for `shmgen echo`: whole messages or one field."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from shmgen.runtime import Message
from shmgen.tools.messages import csv, format, paths


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
            self._titles = csv.line(csv.titles(self._get(kind()), self._field or "")) + "\n"

    def _format(self, value: Any) -> str:
        if self._form == "csv":
            return csv.line(csv.row(value))
        if self._form == "json":
            return format.as_json(value)
        text = format.yaml(value, self._most)
        return f"{text}---"
