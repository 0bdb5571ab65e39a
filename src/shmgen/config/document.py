"""Read the tables of a TOML document and report errors with the line of their key."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shmgen.config import keys
from shmgen.config.keys import Key
from shmgen.core import files, toml
from shmgen.core.diagnostics import Report, Span, closest


def read(path: Path, shown_path: str, prefix: str, report: Report) -> tuple[dict[str, Any], Reader]:
    """Read the table `prefix` of a file, or the whole file for "". Diagnostics call the file `shown_path`.

    Raises Rejected: SHM001, SHM002, SHM503.
    """
    text = contents(path, shown_path, report, "correct the path after -c")
    try:
        document = toml.loads(text)
    except ValueError as error:
        span = _toml_error_span(shown_path, text, error)
        report.error("SHM503", _without_position(error), span, hint=_syntax_hint(span.text, error))
        report.stop_if_any()
    reader = Reader(text, _positions(text, prefix, shown_path), Span(shown_path), report)
    for key in prefix.split(".") if prefix else ():
        document = reader.table(document, key, prefix)
    return document, reader


@dataclass(frozen=True, slots=True)
class Reader:
    """Reads and checks the values of a parsed TOML document. Every error points at the line of its key."""

    text: str
    positions: Mapping[tuple[str, str], Span]
    file: Span
    report: Report

    def values(self, section: str, data: dict[str, Any]) -> dict[str, Any]:
        """Return the value of each key in a table, with defaults for missing keys.

        A section such as `topics.0`, the first of [[topics]], has the keys of `topics`.
        """
        name = section.partition(".")[0]
        known = keys.keys_of(name)
        if name not in keys.FREE_SECTIONS:
            self._known(section, data, (*(key.name for key in known), *(keys.SECTIONS if not name else ())))
        return {key.name: self._value(section, key, data) for key in known}

    def _known(self, section: str, data: dict[str, Any], allowed: tuple[str, ...]) -> None:
        place = f" in [{section.partition('.')[0]}]" if section else ""
        for name in (name for name in data if name not in allowed):
            close = closest(name, allowed)
            hint = f"did you mean {close}?" if close else f"known keys{place}: {', '.join(allowed)}"
            is_header = close in keys.SECTIONS and isinstance(data[name], dict | list)
            home = next((key.section for key in keys.KEYS if key.name == name), "")
            if home and not section and not is_header:
                hint = f"move it under {keys.header(home)}"
            self.report.error("SHM501", f"unknown key {name}{place}", self.span(section, name), hint=hint)

    def table(self, data: dict[str, Any], key: str, header: str = "") -> dict[str, Any]:
        value = data.get(key, {})
        if not isinstance(value, dict):
            self.wrong("", key, f"{key} must be a table: write [{header or key}]")
            return {}
        return value

    def _value(self, section: str, key: Key, data: dict[str, Any]) -> Any:
        value = data.get(key.name)
        if key.name not in data:
            return key.default
        problem, hint = f"{key.name} {key.rule}", key.hint
        match key.kind:
            case "strings":
                return self._strings(section, key, value)
            case "choice":
                if value in key.choices:
                    return value
                problem, close = f"{key.name} must be one of {', '.join(key.choices)}", closest(str(value), key.choices)
                hint = f"did you mean {close}?" if close else ""
            case "integer":
                if type(value) is int and key.least <= value <= key.most:
                    return value
                problem = f"{key.name} must be a whole number from {key.least} to {key.most}"
            case "number":
                if isinstance(value, int | float) and type(value) is not bool and key.least <= value <= key.most:
                    return float(value)
                problem = f"{key.name} must be a number of {key.unit} from {key.least:g} to {key.most:g}"
            case "boolean":
                if type(value) is bool:
                    return value
                problem = f"{key.name} must be true or false"
            case "string":
                if isinstance(value, str) and (not key.pattern or re.fullmatch(key.pattern, value)):
                    return value
        self.wrong(section, key.name, f"{problem}, not {value!r}", hint)
        return key.default

    def _strings(self, section: str, key: Key, value: Any) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            example = key.choices[0] if key.choices else "..."
            self.wrong(section, key.name, f'{key.name} must be a list of strings, such as ["{example}"]')
            return tuple(key.default)
        if key.choices and not value:
            self.wrong(
                section, key.name, f"{key.name} is empty: remove the line, or list some of {', '.join(key.choices)}"
            )
        for item in value:
            if key.choices and item not in key.choices:
                close = closest(item, key.choices)
                hint = f"did you mean {close}?" if close else ""
                self.wrong(section, key.name, f'"{item}" is not one of {", ".join(key.choices)}', hint)
        return tuple(value)

    def number(self, section: str, name: str, data: dict[str, Any]) -> int:
        """Return the number under a key that shmgen does not define, such as a message's name in [bounds]."""
        return int(self._value(section, Key(section, name, "integer", 1, ""), data))

    def wrong(self, section: str, key: str, message: str, hint: str = "") -> None:
        self.report.error("SHM502", message, self.span(section, key), hint=hint)

    def span(self, section: str, key: str) -> Span:
        """Return the position of a key. If this position is unknown, return the position of the key's table.

        The position of a dotted key, or of a key in an inline table, is unknown.
        """
        places = ((section, key), (f"{section}.{key}".lstrip("."), ""), (section, ""), ("", section))
        return next((self.positions[place] for place in places if place in self.positions), self.file)


def quoted(text: str, shown_path: str, words: Collection[str]) -> dict[str, Span]:
    """Map each word of `words` that a TOML document contains in quotes to the position of its first occurrence."""
    places: dict[str, Span] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        if len(places) == len(words):
            break
        for match in _QUOTED.finditer(line):
            if match[1] in words:
                places.setdefault(match[1], _span(shown_path, number, match, 1))
    return places


_HEADER = re.compile(r"\s*(\[\[?)\s*([^\]#]+?)\s*\]")
_KEY = re.compile(r"""\s*("[^"]*"|'[^']*'|[A-Za-z0-9_-]+)\s*[=.]""")
_QUOTED = re.compile(r"""["']([^"']+)["']""")


def _positions(text: str, prefix: str, shown_path: str) -> dict[tuple[str, str], Span]:
    """Return the position of each key of a TOML document, by section and key.

    TOML libraries do not report positions. Entry n of [[topics]], counted from 0, is the section `topics.n`.
    """
    positions: dict[tuple[str, str], Span] = {}
    section, entries = "", Counter[str]()
    for number, line in enumerate(text.split("\n"), start=1):
        if header := _HEADER.match(line):
            section = re.sub(r"\s*\.\s*", ".", header[2])
            section = section.removeprefix(prefix).lstrip(".") if section.startswith(prefix) else f"other {section}"
            if header[1] == "[[":
                entries[section] += 1
                section = f"{section}.{entries[section] - 1}"
            place = _span(shown_path, number, header, 2)
            positions.setdefault(("", section.partition(".")[0]), place)
            positions.setdefault((section, ""), place)
        elif key := _KEY.match(line):
            positions.setdefault((section, key[1].strip("\"'")), _span(shown_path, number, key, 1))
    return positions


def _span(shown_path: str, number: int, match: re.Match[str], group: int) -> Span:
    return Span(shown_path, number, match.start(group) + 1, len(match[group]), match.string.rstrip("\r"))


def contents(path: Path, shown_path: str, report: Report, hint: str) -> str:
    """Return the text of a UTF-8 file. Raises Rejected: SHM001 with `hint` if unreadable, SHM002 if not UTF-8."""
    try:
        text = files.read_file(path).decode("utf-8").removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}")
        return text.replace("\r\n", "\n")
    except OSError as error:
        report.error("SHM001", f"cannot read: {error.strerror}", Span(shown_path), hint=hint)
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode()
        place = Span(shown_path, before.count("\n") + 1, len(before) - before.rfind("\n"))
        culprit = f"byte 0x{error.object[error.start]:02X} is not UTF-8"
        report.error("SHM002", culprit, place, hint="save the file as UTF-8")
    report.stop_if_any()
    raise AssertionError


# Compiled only after an error.
_AT = r" \(at (?:line (\d+), column (\d+)|end of document)\)$"
_SYNTAX_HINTS = (
    (r"\s*([\w-]+(?:/[\w.-]+)+)\s*=", 'put a key with a slash in quotes: "{}" = 8'),
    (r"\s*[\w-]+\s*=\s*(True|False)\b", "write true and false in lower case"),
    (r"(\s*[\w-]+\s*=\s*[A-Za-z~./][\w~/.-]*)\s*(?:#.*)?$", "put the text in quotes: {}"),
    (r"\s*[\w-]+\s*=\s*\[(?:.*,)?\s*[A-Za-z~./]", 'put each text in the list in quotes: ["geometry_msgs/Pose"]'),
    (r"\s*[\w-]+\s*:", "write `=` after the key: this is TOML, not YAML"),
    (r'.*"[^"]*\\', "write `/` in paths, on Windows too"),
    (r'.*"\s+"', "put a comma between the items of a list"),
    (r".*\[[^\]]*$", "end the list with `]`"),
)
"""Pattern of a line that is not TOML, and its hint: the most frequent mistakes."""


def _without_position(error: Exception) -> str:
    text = re.sub(_AT, "", str(error))
    return text[:1].lower() + text[1:]


def _syntax_hint(line: str, error: Exception) -> str:
    if "overwrite" in str(error):
        return "remove one of the two: this key is set twice"
    for pattern, hint in _SYNTAX_HINTS:
        if match := re.match(pattern, line):
            words = re.sub(r"=\s*(.*)$", r'= "\1"', match[1].strip()) if match.lastindex else ""
            return hint.format(words)
    if "nclosed array" in str(error):
        return "end the list with `]`"
    return 'write `[section]` or `key = value`, with text in quotes: source = "jazzy"'


def _toml_error_span(shown_path: str, text: str, error: Exception) -> Span:
    place = re.search(_AT, str(error))
    if not place:
        return Span(shown_path)
    lines = text.split("\n")
    line, column = (int(place[1]), int(place[2])) if place[1] else (len(lines), len(lines[-1]) + 1)
    return Span(shown_path, line, column, 1, lines[line - 1].rstrip("\r") if line <= len(lines) else "")
