"""Tables of a TOML document that know where each key stands, and complain about what is wrong in them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from shmgen.config import keys
from shmgen.config.keys import Key
from shmgen.core import files, toml
from shmgen.core.diagnostics import Report, Span, closest
from shmgen.core.fast_dataclass import dataclass


def read(path: Path, shown: str, prefix: str, report: Report) -> tuple[dict[str, Any], Reader]:
    """The table `prefix` of file `path` (all of it for ""), called `shown` in diagnostics.

    Raises Rejected: SHM001, SHM002, SHM503.
    """
    text = contents(path, shown, report, "give a file that can be read with -c")
    try:
        document = toml.loads(text)
    except ValueError as error:
        span = _toml_error_span(shown, text, error)
        report.error("SHM503", _without_position(error), span, hint=_meant(span.text, error))
        report.stop_if_any()
    reader = Reader(text, _positions(text, prefix, shown), Span(shown), report)
    for key in prefix.split(".") if prefix else ():
        document = reader.table(document, key, prefix)
    return document, reader


@dataclass(frozen=True, slots=True)
class Reader:
    """Takes the parsed document apart; every complaint carries the line it is about."""

    text: str
    positions: Mapping[tuple[str, str], Span]
    file: Span
    report: Report

    def values(self, section: str, data: dict[str, Any]) -> dict[str, Any]:
        """{key: value} of a table; `topics.0` has the keys of `topics`."""
        name = section.partition(".")[0]
        known = keys.of(name)
        if name not in keys.OPEN:
            self._known(section, data, (*(key.name for key in known), *(keys.SECTIONS if not name else ())))
        return {key.name: self._value(section, key, data) for key in known}

    def _known(self, section: str, data: dict[str, Any], allowed: tuple[str, ...]) -> None:
        place = f" in [{section.partition('.')[0]}]" if section else ""
        for name in data:
            if name not in allowed:
                close = closest(name, allowed)
                hint = f"did you mean {close}?" if close else f"known keys{place}: {', '.join(allowed)}"
                is_header = close in keys.SECTIONS and isinstance(data[name], dict | list)
                if (
                    not section
                    and not is_header
                    and (home := next((key for key in keys.KEYS if key.name == name), None))
                ):
                    hint = f"it belongs under {keys.header(home.section)}"
                self.report.error("SHM501", f"unknown key {name}{place}", self.span(section, name), hint=hint)

    def table(self, data: dict[str, Any], key: str, header: str = "") -> dict[str, Any]:
        value = data.get(key, {})
        if not isinstance(value, dict):
            self.wrong("", key, f"{key} is a table: write [{header or key}]")
            return {}
        return value

    def _value(self, section: str, key: Key, data: dict[str, Any]) -> Any:
        value = data.get(key.name)
        if key.name not in data:
            return key.default
        said, hint = f"{key.name} {key.rule}", key.hint
        match key.kind:
            case "strings":
                return self._strings(section, key, value)
            case "choice":
                if value in key.choices:
                    return value
                said, close = f"{key.name} is one of {', '.join(key.choices)}", closest(str(value), key.choices)
                hint = f"did you mean {close}?" if close else ""
            case "integer":
                if type(value) is int and key.least <= value <= key.most:
                    return value
                said = f"{key.name} is a whole number from {key.least} to {key.most}"
            case "number":
                if isinstance(value, int | float) and type(value) is not bool and key.least <= value <= key.most:
                    return float(value)
                said = f"{key.name} is a number of {key.unit} from {key.least:g} to {key.most:g}"
            case "boolean":
                if type(value) is bool:
                    return value
                said = f"{key.name} is true or false"
            case "string":
                if isinstance(value, str) and (not key.pattern or re.fullmatch(key.pattern, value)):
                    return value
        self.wrong(section, key.name, f"{said}, not {value!r}", hint)
        return key.default

    def _strings(self, section: str, key: Key, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            example = key.choices[0] if key.choices else "..."
            self.wrong(section, key.name, f'{key.name} is a list of strings, such as ["{example}"]')
            return tuple(key.default)
        if key.choices and not value:
            self.wrong(
                section, key.name, f"{key.name} is empty: leave it out, or name some of {', '.join(key.choices)}"
            )
        for item in value:
            if key.choices and item not in key.choices:
                close = closest(item, key.choices)
                hint = f"did you mean {close}?" if close else ""
                self.wrong(section, key.name, f'"{item}" is not one of {", ".join(key.choices)}', hint)
        return tuple(value)

    def number(self, section: str, name: str, data: dict[str, Any]) -> int:
        """Of a key that the user has made up."""
        return int(self._value(section, Key(section, name, "integer", 1, ""), data))

    def wrong(self, section: str, key: str, message: str, hint: str = "") -> None:
        self.report.error("SHM502", message, self.span(section, key), hint=hint)

    def span(self, section: str, key: str) -> Span:
        """Of the key; if it is in an inline table or a dotted key, of what holds it."""
        places = ((section, key), (f"{section}.{key}".lstrip("."), ""), (section, ""), ("", section))
        return next((self.positions[place] for place in places if place in self.positions), self.file)

    def quoted(self, words: Collection[str]) -> dict[str, Span]:
        """Where each of `words` first stands in quotes in the document, of those that do."""
        return quoted(self.text, self.file.path, words)


def quoted(text: str, shown: str, words: Collection[str]) -> dict[str, Span]:
    """Where each of `words` first stands in quotes in a TOML document, of those that do."""
    places: dict[str, Span] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        if len(places) == len(words):
            break
        for found in _QUOTED.finditer(line):
            if found[1] in words:
                places.setdefault(found[1], _span(shown, number, line, found.start(1), found.end(1)))
    return places


_HEADER = re.compile(r"\s*(\[\[?)\s*([^\]#]+?)\s*\]")
_KEY = re.compile(r"""\s*("[^"]*"|'[^']*'|[A-Za-z0-9_-]+)\s*[=.]""")
_QUOTED = re.compile(r"""["']([^"']+)["']""")


def _positions(text: str, prefix: str, shown: str) -> dict[tuple[str, str], Span]:
    """Where each (section, key) stands; TOML libraries tell no positions. Entry n of [[topics]] is `topics.n`."""
    positions: dict[tuple[str, str], Span] = {}
    section, entries = "", Counter[str]()
    for number, line in enumerate(text.split("\n"), start=1):
        if header := _HEADER.match(line):
            section = re.sub(r"\s*\.\s*", ".", header[2])
            section = section.removeprefix(prefix).lstrip(".") if section.startswith(prefix) else f"other {section}"
            if header[1] == "[[":
                entries[section] += 1
                section = f"{section}.{entries[section] - 1}"
            positions.setdefault(
                ("", section.partition(".")[0]), _span(shown, number, line, header.start(2), header.end(2))
            )
            positions.setdefault((section, ""), _span(shown, number, line, header.start(2), header.end(2)))
        elif key := _KEY.match(line):
            positions.setdefault((section, key[1].strip("\"'")), _span(shown, number, line, key.start(1), key.end(1)))
    return positions


def _span(shown: str, number: int, line: str, start: int, end: int) -> Span:
    return Span(shown, number, start + 1, end - start, line.rstrip("\r"))


def contents(path: Path, shown: str, report: Report, hint: str) -> str:
    """The text of a file; the hint is for one that cannot be read. Raises Rejected: SHM001, SHM002."""
    try:
        text = files.content(path).decode("utf-8").removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}")
        return text.replace("\r\n", "\n")
    except OSError as error:
        report.error("SHM001", f"cannot read: {error.strerror}", Span(shown), hint=hint)
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode()
        place = Span(shown, before.count("\n") + 1, len(before) - before.rfind("\n"))
        culprit = f"byte 0x{error.object[error.start]:02X} is not UTF-8"
        report.error("SHM002", culprit, place, hint="save the file as UTF-8")
    report.stop_if_any()
    raise AssertionError


# Compiled when something is wrong.
_AT = r" \(at (?:line (\d+), column (\d+)|end of document)\)$"
_MEANT = (
    (r"\s*([\w-]+(?:/[\w.-]+)+)\s*=", 'a key with a slash stands in quotes: "{}" = 8'),
    (r"\s*[\w-]+\s*=\s*(True|False)\b", "the words are true and false, written small"),
    (r"(\s*[\w-]+\s*=\s*[A-Za-z][\w/.-]*)\s*(?:#.*)?$", "a word stands in quotes: {}"),
    (r"\s*[\w-]+\s*:", "a key is followed by `=`: this is TOML, not YAML"),
    (r'.*"[^"]*\\', "write `/` in paths, on Windows too"),
    (r'.*"\s+"', "a comma stands between the items of a list"),
    (r".*\[[^\]]*$", "a list ends with `]`"),
)
"""What a line that is no TOML looks like, and what to do: the mistakes most often made."""


def _without_position(error: Exception) -> str:
    text = re.sub(_AT, "", str(error))
    return text[:1].lower() + text[1:]


def _meant(line: str, error: Exception) -> str:
    if "overwrite" in str(error):
        return "this key is there twice: keep one of them"
    found = next(((match, hint) for pattern, hint in _MEANT if (match := re.match(pattern, line))), None)
    if found is None:
        return ""
    words = re.sub(r"=\s*(.*)$", r'= "\1"', found[0][1].strip()) if found[0].lastindex else ""
    return found[1].format(words)


def _toml_error_span(shown: str, text: str, error: Exception) -> Span:
    if not re.search(_AT, str(error)):
        return Span(shown)
    lines = text.split("\n")
    found = re.search(_AT, str(error))
    line, column = (int(found[1]), int(found[2])) if found and found[1] else (len(lines), len(lines[-1]) + 1)
    return Span(shown, line, column, 1, lines[line - 1].rstrip("\r") if line <= len(lines) else "")
