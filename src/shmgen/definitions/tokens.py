"""Places in a definition, so that every complaint can point at what is wrong."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

from shmgen.core.diagnostics import Span

Dialect: TypeAlias = Literal["ros1", "ros2"]

_LONGEST_LINE_SHOWN = 240
_LONGEST_TEXT_SHOWN = 60


class Wrong(Exception):
    """A declaration that cannot be used; the parser turns it into a diagnostic and reads on."""

    def __init__(self, code: str, message: str, span: Span, hint: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.span = span
        self.hint = hint


class Line(NamedTuple):
    """One line of a definition, counted from 1, without its end."""

    path: str
    number: int
    text: str

    def span(self, start: int = 0, width: int = 0) -> Span:
        """`start` counts characters from 0. A line that no terminal should get is left out."""
        text = self.text if len(self.text) <= _LONGEST_LINE_SHOWN else ""
        if not text.isprintable():
            text = text if text.replace("\t", " ").isprintable() else ""
        return Span(self.path, self.number, start + 1, width, text)


class Token(NamedTuple):
    """A stretch of a line."""

    line: Line
    start: int
    text: str

    @property
    def span(self) -> Span:
        return self.line.span(self.start, len(self.text))

    def part(self, start: int, end: int | None = None) -> Token:
        """The characters from `start` up to `end`, without blanks around them."""
        text = self.text[start:end]
        blanks = len(text) - len(text.lstrip())
        return Token(self.line, self.start + start + blanks, text.strip())

    def wrong(self, code: str, message: str, hint: str = "") -> Wrong:
        return Wrong(code, message, self.span, hint)


def shown(text: str) -> str:
    """The user's words inside a message: quoted, cut when long, nothing in them that a terminal obeys."""
    cut = text if len(text) <= _LONGEST_TEXT_SHOWN else text[:_LONGEST_TEXT_SHOWN] + "…"
    return "`" + "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in cut) + "`"
