"""Positions in a definition, so that every diagnostic can point at the error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

from shmgen.core.diagnostics import Span

Dialect: TypeAlias = Literal["ros1", "ros2"]

_LONGEST_LINE_SHOWN = 240
_LONGEST_TEXT_SHOWN = 60


@dataclass(eq=False)
class DefinitionError(Exception):
    """A declaration is not usable. The parser turns this exception into a diagnostic and continues."""

    code: str
    message: str
    span: Span
    hint: str = ""


class Line(NamedTuple):
    """One line of a definition, without its line break. `number` counts from 1."""

    path: str
    number: int
    text: str

    def span(self, start: int = 0, width: int = 0) -> Span:
        """Return the position of `width` characters in this line, for a diagnostic. `start` counts from 0.

        The diagnostic shows the line, except if the line is too long or has unprintable characters.
        """
        is_shown = len(self.text) <= _LONGEST_LINE_SHOWN and self.text.replace("\t", " ").isprintable()
        return Span(self.path, self.number, start + 1, width, self.text if is_shown else "")


class Token(NamedTuple):
    """A part of a line: `text` begins at character `start`, counted from 0."""

    line: Line
    start: int
    text: str

    @property
    def span(self) -> Span:
        return self.line.span(self.start, len(self.text))

    def part(self, start: int, end: int | None = None) -> Token:
        """Return the characters from `start` up to `end`, without surrounding blanks."""
        text = self.text[start:end]
        blanks = len(text) - len(text.lstrip())
        return Token(self.line, self.start + start + blanks, text.strip())

    def error(self, code: str, message: str, hint: str = "") -> DefinitionError:
        return DefinitionError(code, message, self.span, hint)


def quote(text: str) -> str:
    """Quote the user's text for a diagnostic. Truncate long text and replace unprintable characters."""
    cut = text if len(text) <= _LONGEST_TEXT_SHOWN else text[:_LONGEST_TEXT_SHOWN] + "…"
    return "`" + "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in cut) + "`"
