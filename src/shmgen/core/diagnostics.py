"""Diagnostics: errors in the user's input, each with its position in a file, its reason and a hint."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

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
    "SHM410": "meaning changed",
    "SHM501": "unknown key",
    "SHM502": "bad value",
    "SHM503": "not TOML",
    "SHM504": "nothing to do",
    "SHM505": "ambiguous package",
    "SHM506": "no ROS in the environment",
    "SHM601": "ROS has no such type",
    "SHM602": "not declared in the PLC project",
    "SHM603": "layout of the PLC differs",
    "SHM701": "no such region",
    "SHM702": "cannot open",
    "SHM703": "call without response",
    "SHM704": "invalid value",
    "SHM705": "unreadable bag",
    "SHM706": "missing package",
    "SHM901": "internal error",
}
"""Code -> title. Each code has a section in src/shmgen/diagnostics.md and a folder in tests/errors."""


class Span(NamedTuple):
    """A position in a file: `width` characters from `line` and `column`, which count from 1.

    If `line` is 0, the span is the whole file. `text` is the content of the line without its line break.
    """

    path: str
    line: int = 0
    column: int = 0
    width: int = 0
    text: str = ""

    def at(self, word: str) -> Span:
        """Return the span of the next `word` after this span in the same line. If there is none, return this span."""
        start = self.text.find(word, self.column - 1 + self.width)
        return self if start < 0 else Span(self.path, self.line, start + 1, len(word), self.text)


class Diagnostic(NamedTuple):
    """One error or note about the user's input. `hint` is the next step for the user.

    `field` is the path of the affected field, such as `Pose.position`. `details` are further lines. A note does not
    make the command fail.
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
    """The user's input is invalid. `diagnostics` has at least one diagnostic."""

    def __init__(self, diagnostics: Iterable[Diagnostic]) -> None:
        self.diagnostics = tuple(diagnostics)
        super().__init__("\n".join(map(str, self.diagnostics)))


_MOST_OF_ONE_FILE = 20


@dataclass(slots=True)
class Report:
    """Collects the diagnostics of one part of a command's work, such as reading all definitions.

    After this part, the caller calls stop_if_any(), which raises an error if there are diagnostics.
    """

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
        """Return True if the file `path` has _MOST_OF_ONE_FILE errors, so that the parser of the file should stop."""
        return self._of_file[path] >= _MOST_OF_ONE_FILE

    def stop_if_any(self) -> None:
        """Raise Rejected if this report has diagnostics. The error contains them, sorted by file and line."""
        files = list(dict.fromkeys(error.span.path for error in self.diagnostics))
        if files:
            raise Rejected(sorted(self.diagnostics, key=lambda error: (files.index(error.span.path), error.span.line)))


def closest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """Return the name in `known` that is most similar to the misspelt `word`, or `""` if none is similar."""
    from difflib import get_close_matches  # slow to load, and needed only after an error

    return next(iter(get_close_matches(word, [other for other in known if other != word], n=1, cutoff=cutoff)), "")
