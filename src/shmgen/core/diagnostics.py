"""What is wrong with the user's input: where, why, and what to type next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import field
from typing import Literal

from shmgen.core.fast_dataclass import dataclass

CODES = {
    "SHM001": "cannot read file",
    "SHM002": "not UTF-8",
    "SHM003": "syntax error",
    "SHM004": "unknown type",
    "SHM005": "value out of range",
    "SHM006": "value of the wrong type",
    "SHM007": "cannot write output",
    "SHM008": "no parser for .idl",
    "SHM101": "unbounded sequence",
    "SHM102": "bad bound",
    "SHM103": "bound already in the definition",
    "SHM201": "duplicate name",
    "SHM202": "invalid name",
    "SHM203": "name clash in a target",
    "SHM204": "name reserved for the generator",
    "SHM301": "recursive message",
    "SHM302": "zero-length array",
    "SHM303": "message too large",
    "SHM304": "nested too deeply",
    "SHM305": "unknown to a dialect",
    "SHM401": "layout changed",
    "SHM402": "definition changed",
    "SHM403": "generated file stale",
    "SHM404": "generated file edited",
    "SHM405": "generated file missing",
    "SHM406": "generated file left over",
    "SHM407": "missing layout.lock",
    "SHM408": "damaged layout.lock",
    "SHM409": "configuration changed",
    "SHM410": "unit changed",
    "SHM501": "unknown key",
    "SHM502": "bad value",
    "SHM503": "not TOML",
    "SHM504": "nothing to generate",
    "SHM505": "ambiguous package",
    "SHM506": "no ROS in the environment",
    "SHM601": "ROS has no such type",
    "SHM602": "not declared in the PLC project",
    "SHM901": "internal error",
}
"""Code -> title. Each has a section in docs/diagnostics.md and a folder in tests/errors."""


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of one line: `line` and `column` from 1 (0 = the whole file), `text` the line without its end."""

    path: str
    line: int = 0
    column: int = 0
    width: int = 0
    text: str = ""

    def at(self, word: str) -> Span:
        """Of `word` where it follows in the same line; of a type, that of the name declared with it."""
        start = self.text.find(word, self.column - 1 + self.width)
        return self if start < 0 else Span(self.path, self.line, start + 1, len(word), self.text)


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One finding. `field` is the path of a nested culprit, `details` lines of their own, `hint` what to type next.

    A `note` is told, and nothing fails for it.
    """

    code: str
    message: str
    span: Span
    field: str = ""
    hint: str = ""
    details: tuple[str, ...] = ()
    level: Literal["error", "note"] = "error"

    def __str__(self) -> str:
        where = ":".join(str(part) for part in (self.span.path, self.span.line, self.span.column) if part)
        lines = [f"{where}: {self.level}[{self.code}]: {self.message}"]
        if self.span.text:
            text = self.span.text.expandtabs(1)
            number = f"{self.span.line:>5} | "
            lines.append(number + text)
            lines.append("      | " + " " * (self.span.column - 1) + "^" * max(1, self.span.width))
        if self.field:
            lines.append(f"  field: {self.field}")
        lines += [f"  {detail}" for detail in self.details]
        lines += [f"  hint: {hint}" for hint in self.hint.splitlines()]
        return "\n".join(lines)


class Rejected(Exception):
    """The input cannot be used; holds at least one diagnostic."""

    def __init__(self, diagnostics: Iterable[Diagnostic]) -> None:
        self.diagnostics = tuple(diagnostics)
        super().__init__("\n".join(map(str, self.diagnostics)))


_MOST_OF_ONE_FILE = 20


@dataclass(slots=True)
class Report:
    """Collects the diagnostics of a stage; `stop_if_any` ends it."""

    diagnostics: list[Diagnostic] = field(default_factory=list)
    _known: set[Diagnostic] = field(default_factory=set)
    _of_file: Counter[str] = field(default_factory=Counter)

    def error(self, code: str, message: str, span: Span, *, field: str = "", hint: str = "") -> None:
        diagnostic = Diagnostic(code, message, span, field, hint)
        if diagnostic not in self._known:
            self._known.add(diagnostic)
            self._of_file[span.path] += 1
            self.diagnostics.append(diagnostic)

    def is_enough(self, path: str) -> bool:
        """Whether that file has so much wrong with it that more would help nobody."""
        return self._of_file[path] >= _MOST_OF_ONE_FILE

    def stop_if_any(self) -> None:
        """Raises Rejected with all that was collected, file by file, from top to bottom."""
        files = list(dict.fromkeys(found.span.path for found in self.diagnostics))
        if files:
            raise Rejected(sorted(self.diagnostics, key=lambda found: (files.index(found.span.path), found.span.line)))


def closest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The one of `known` that was probably meant, or nothing."""
    from difflib import get_close_matches  # slow to load, and needed only where something is wrong

    return next(iter(get_close_matches(word, list(known), n=1, cutoff=cutoff)), "")
