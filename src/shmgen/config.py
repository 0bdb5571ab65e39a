"""Turns shmgen.toml (or `[tool.shmgen]` in pyproject.toml) into a Config, with the line of whatever is wrong."""

from __future__ import annotations

import keyword
import re
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from shmgen.bounds import DEFAULT_STRING, Bound, Bounds
from shmgen.diagnostics import Report, Span, closest
from shmgen.model import TypeOptions

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FILE_NAME = "shmgen.toml"
TARGETS = ("python", "st", "plcopen", "c")
SOURCES = ("jazzy", "humble", "noetic", "kilted", "lyrical", "iron", "galactic", "foxy", "eloquent", "dashing")
MAX_REGION = 16 * 2**20
"""Bytes; more than any sane topic, less than what a forgotten bound makes."""
TASK_INTERVAL = 10
"""Milliseconds between two calls of the generated PROGRAM."""
MAX_DEPTH = 65535
"""MAX_DEPTH of FB_ShmRegion."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One `[[topics]]` entry: `depth` is how many samples a slow reader can still fetch."""

    topic: str
    type: str
    direction: str
    depth: int
    span: Span


@dataclass(frozen=True, slots=True)
class Config:
    """The user's words; `root` is the folder that relative paths start from.

    `places` says where each of `messages`, and the type of each topic, is written.
    """

    root: Path
    messages: tuple[str, ...] = ()
    source: str = "jazzy"
    path: tuple[Path, ...] = ()
    targets: tuple[str, ...] = TARGETS
    package: str = "shm_msgs"
    distribution: str = ""
    max_region: int = MAX_REGION
    task_interval: int = TASK_INTERVAL
    types: TypeOptions = field(default_factory=TypeOptions)
    bounds: Bounds = field(default_factory=lambda: Bounds({}, {}))
    topics: tuple[Topic, ...] = ()
    places: Mapping[str, Span] = field(default_factory=dict)


def find(start: Path) -> Path | None:
    """The configuration file in force in folder `start`, if there is one."""
    if (start / FILE_NAME).is_file():
        return start / FILE_NAME
    project = start / "pyproject.toml"
    if project.is_file() and b"[tool.shmgen" in project.read_bytes():
        return project
    return None


def load(path: Path, shown: str, report: Report) -> Config:
    """Reads `path`, called `shown` in diagnostics. Raises Rejected: SHM001, 002, 501, 502, 503."""
    text = _read(path, shown, report)
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        span = _toml_error_span(shown, text, error)
        report.error("SHM503", _without_position(error), span, hint=_missing_quotes(span.text))
        report.stop_if_any()
    prefix = "tool.shmgen" if path.name == "pyproject.toml" else ""
    reader = _Reader(_positions(text, prefix, shown), Span(shown), report)
    data = reader.table(reader.table(document, "tool"), "shmgen", "tool.shmgen") if prefix else document
    config = reader.config(data, path.parent)
    report.stop_if_any()
    return replace(config, places=quoted(text, shown, {*config.messages, *(topic.type for topic in config.topics)}))


def quoted(text: str, shown: str, words: Collection[str]) -> dict[str, Span]:
    """Where each of `words` first stands in quotes in a TOML document, of those that do."""
    places: dict[str, Span] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        for found in _QUOTED.finditer(line):
            if found[1] in words:
                places.setdefault(found[1], _span(shown, number, line, found.start(1), found.end(1)))
    return places


@dataclass(frozen=True, slots=True)
class _Reader:
    """Takes the parsed document apart; every complaint carries the line it is about."""

    positions: Mapping[tuple[str, str], Span]
    file: Span
    report: Report

    def config(self, data: dict[str, Any], root: Path) -> Config:
        known = ("messages", "source", "path", "targets", "package", "distribution", "max_region", "task_interval")
        self.keys("", data, (*known, "types", "strings", "bounds", "topics"))
        types, strings, bounds = (self.table(data, name) for name in ("types", "strings", "bounds"))
        self.keys("types", types, ("bool", "time"))
        return Config(
            root=root,
            messages=tuple(_from(root, message) for message in self.texts("messages", data, ())),
            source=self.choice("", "source", data, SOURCES, "jazzy"),
            path=tuple(root / folder for folder in self.texts("path", data, ())),
            targets=self.texts("targets", data, TARGETS, TARGETS),
            package=self.package(data),
            distribution=self.distribution(data),
            max_region=self.number("", "max_region", data, MAX_REGION),
            task_interval=self.number("", "task_interval", data, TASK_INTERVAL),
            types=TypeOptions(
                bool=self.choice("types", "bool", types, ("USINT", "BOOL"), "USINT"),  # type: ignore[arg-type]
                time=self.choice("types", "time", types, ("TIME", "LTIME", "struct"), "TIME"),  # type: ignore[arg-type]
                encoding=self.choice("strings", "encoding", strings, ("utf-8", "latin-1"), "utf-8"),  # type: ignore[arg-type]
                overflow=self.choice("strings", "overflow", strings, ("error", "truncate"), "error"),  # type: ignore[arg-type]
            ),
            bounds=Bounds(
                strings=self.bound_table("strings", strings, ("default", "encoding", "overflow")),
                sequences=self.bound_table("bounds", bounds, ()),
                default_string=self.number("strings", "default", strings, DEFAULT_STRING),
            ),
            topics=self.topics(data),
        )

    def topics(self, data: dict[str, Any]) -> tuple[Topic, ...]:
        entries = data.get("topics", [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            self.wrong("", "topics", "topics is a list of tables: write [[topics]]")
            return ()
        topics: list[Topic] = []
        for index, entry in enumerate(entries):
            section = f"topics.{index}"
            self.keys(section, entry, ("topic", "type", "direction", "depth"))
            for key in ("topic", "type"):
                if key not in entry:
                    self.report.error("SHM502", f'a [[topics]] entry needs {key} = "..."', self.span(section, ""))
                elif not isinstance(entry[key], str):
                    self.wrong(section, key, f"{key} is a string, not {entry[key]!r}")
            direction = self.choice(section, "direction", entry, ("to_plc", "from_plc"), "to_plc")
            depth = self.number(section, "depth", entry, 1, MAX_DEPTH)
            span = self.span(section, "topic")
            if isinstance(entry.get("topic"), str) and (why := _not_a_topic(entry["topic"])):
                self.wrong(section, "topic", f"topic {entry['topic']} {why}")
            if isinstance(entry.get("type"), str) and not _MESSAGE.fullmatch(entry["type"]):
                self.wrong(section, "type", f"type {entry['type']} names no message: write package/Name")
            topics.append(Topic(str(entry.get("topic")), str(entry.get("type")), direction, depth, span))
            if any(topic.topic == entry.get("topic") for topic in topics[:-1]):
                self.report.error("SHM502", f"topic {entry.get('topic')} is listed twice", span)
        return tuple(topics)

    def bound_table(self, section: str, data: dict[str, Any], options: tuple[str, ...]) -> dict[str, Bound]:
        table: dict[str, Bound] = {}
        for key in data:
            if key in options:
                continue
            close = closest(key, options, 0.8)
            if isinstance(data[key], dict):
                hint = 'a key with a slash or a dot stands in quotes: "package/Message.field" = 8'
                self.report.error("SHM502", f"{key} is a number, not a table", self.span(section, key), hint=hint)
            elif close or not _BOUND_KEY.fullmatch(key):
                hint = 'a key here is "package/Message.field", "package/Message" or "package"'
                hint += f", or one of {', '.join(options)}" if options else ""
                hint = f"did you mean {close}?" if close else hint
                self.report.error("SHM501", f"unknown key {key} in [{section}]", self.span(section, key), hint=hint)
            else:
                table[key] = Bound(self.number(section, key, data, 1), self.span(section, key))
        return table

    def package(self, data: dict[str, Any]) -> str:
        name = data.get("package", "shm_msgs")
        usable = isinstance(name, str) and name.isascii() and name.isidentifier() and not keyword.iskeyword(name)
        if not usable or name == "shmgen":  # that one is imported by what is generated
            self.wrong("", "package", f'package names the Python package to make, such as "shm_msgs", not {name!r}')
            return "shm_msgs"
        return str(name)

    def distribution(self, data: dict[str, Any]) -> str:
        value = data.get("distribution", "")
        if isinstance(value, str) and (not value or _DISTRIBUTION.fullmatch(value)):
            return value
        example = '"robot-shm 1.2.0"'
        self.wrong("", "distribution", f"distribution is a name and a version, such as {example}, not {value!r}")
        return ""

    def keys(self, section: str, data: dict[str, Any], allowed: tuple[str, ...]) -> None:
        place = f" in [{section.partition('.')[0]}]" if section else ""
        for key in data:
            if key not in allowed:
                close = closest(key, allowed)
                hint = f"did you mean {close}?" if close else f"known keys{place}: {', '.join(allowed)}"
                if not section and key in _HOMES:
                    hint = f"it belongs under [{_HOMES[key]}]"
                self.report.error("SHM501", f"unknown key {key}{place}", self.span(section, key), hint=hint)

    def table(self, data: dict[str, Any], key: str, header: str = "") -> dict[str, Any]:
        value = data.get(key, {})
        if not isinstance(value, dict):
            self.wrong("", key, f"{key} is a table: write [{header or key}]")
            return {}
        return value

    def texts(
        self, key: str, data: dict[str, Any], default: tuple[str, ...], choices: tuple[str, ...] = ()
    ) -> tuple[str, ...]:
        value = data.get(key, list(default))
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self.wrong("", key, f'{key} is a list of strings, such as ["{choices[0] if choices else "..."}"]')
            return default
        if choices and not value:
            self.wrong("", key, f"{key} is empty: leave it out, or name some of {', '.join(choices)}")
        for item in value:
            if choices and item not in choices:
                self.wrong("", key, f'"{item}" is not one of {", ".join(choices)}')
        return tuple(value)

    def choice(self, section: str, key: str, data: dict[str, Any], choices: tuple[str, ...], default: str) -> str:
        value = data.get(key, default)
        if value not in choices:
            close = closest(str(value), choices)
            hint = f"did you mean {close}?" if close else ""
            self.wrong(section, key, f"{key} is one of {', '.join(choices)}, not {value!r}", hint)
            return default
        return str(value)

    def number(self, section: str, key: str, data: dict[str, Any], default: int, most: int = 2**31 - 1) -> int:
        value = data.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= most:
            self.wrong(section, key, f"{key} is a whole number from 1 to {most}, not {value!r}")
            return default
        return value

    def wrong(self, section: str, key: str, message: str, hint: str = "") -> None:
        self.report.error("SHM502", message, self.span(section, key), hint=hint)

    def span(self, section: str, key: str) -> Span:
        """Of the key; if it is in an inline table or a dotted key, of what holds it."""
        places = ((section, key), (f"{section}.{key}".lstrip("."), ""), (section, ""), ("", section))
        return next((self.positions[place] for place in places if place in self.positions), self.file)


_DISTRIBUTION = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])? [0-9]+(\.[0-9]+)*((a|b|rc|\.post|\.dev)[0-9]+)?")
"""Names of PEP 508 and the common versions of PEP 440."""
_MESSAGE = re.compile(r"[A-Za-z]\w*/((msg|srv|action)/)?[A-Za-z]\w*", re.ASCII)
LONGEST_TOPIC = 74
"""MAX_NAME of FB_ShmRegion: its STRING(80) less `-event`."""


def _not_a_topic(name: str) -> str:
    """Why it cannot be a topic of a PLC, or nothing."""
    bare = name.removeprefix("/")
    if not re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", bare, re.ASCII):
        return "is not made of letters, digits and _ between single slashes, no digit first"
    if len(bare) > LONGEST_TOPIC:
        return f"has {len(bare)} characters, more than the {LONGEST_TOPIC} of a STRING(80) and its suffix"
    return "begins with sem/, where Linux keeps the semaphores" if bare.startswith("sem/") else ""


_BOUND_KEY = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*(\.[A-Za-z]\w*)?)?")
_HEADER = re.compile(r"\s*(\[\[?)\s*([^\]#]+?)\s*\]")
_KEY = re.compile(r"""\s*("[^"]*"|'[^']*'|[A-Za-z0-9_-]+)\s*[=.]""")
_QUOTED = re.compile(r"""["']([^"']+)["']""")
_HOMES = {"bool": "types", "time": "types", "default": "strings", "encoding": "strings", "overflow": "strings"}


def _positions(text: str, prefix: str, shown: str) -> dict[tuple[str, str], Span]:
    """Where each (section, key) stands; TOML libraries tell no positions. Entry n of [[topics]] is `topics.n`."""
    positions: dict[tuple[str, str], Span] = {}
    section, entries = "", 0
    for number, line in enumerate(text.split("\n"), start=1):
        if header := _HEADER.match(line):
            section = re.sub(r"\s*\.\s*", ".", header[2])
            section = section.removeprefix(prefix).lstrip(".") if section.startswith(prefix) else f"other {section}"
            if header[1] == "[[":
                section, entries = f"{section}.{entries}", entries + 1
            positions.setdefault((section, ""), _span(shown, number, line, header.start(2), header.end(2)))
        elif key := _KEY.match(line):
            positions.setdefault((section, key[1].strip("\"'")), _span(shown, number, line, key.start(1), key.end(1)))
    return positions


def _from(root: Path, message: str) -> str:
    return str(root / message) if message.endswith((".msg", ".srv", ".action")) else message


def _span(shown: str, number: int, line: str, start: int, end: int) -> Span:
    return Span(shown, number, start + 1, end - start, line.rstrip("\r"))


def _read(path: Path, shown: str, report: Report) -> str:
    try:
        return path.read_bytes().decode("utf-8").removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}")
    except OSError as error:
        report.error(
            "SHM001", f"cannot read: {error.strerror}", Span(shown), hint="give a file that can be read with -c"
        )
    except UnicodeDecodeError as error:
        before = error.object[: error.start].decode()
        place = Span(shown, before.count("\n") + 1, len(before) - before.rfind("\n"))
        culprit = f"byte 0x{error.object[error.start]:02X} is not UTF-8"
        report.error("SHM002", culprit, place, hint="save the file as UTF-8")
    report.stop_if_any()
    raise AssertionError


_AT = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
_BARE_KEY = re.compile(r"\s*([\w-]+(?:/[\w.-]+)+)\s*=")
_BARE_VALUE = re.compile(r"(\s*[\w-]+\s*=\s*)([A-Za-z][\w/.-]*)\s*(#.*)?")


def _without_position(error: Exception) -> str:
    text = _AT.sub("", str(error))
    return text[:1].lower() + text[1:]


def _missing_quotes(line: str) -> str:
    """The mistake most often made: a message's name as a key, or a word as a value, without quotes."""
    if key := _BARE_KEY.match(line):
        return f'a key with a slash stands in quotes: "{key[1]}" = 8'
    if value := _BARE_VALUE.fullmatch(line):
        return f'a word stands in quotes: {value[1].strip()} "{value[2]}"'
    return ""


def _toml_error_span(shown: str, text: str, error: Exception) -> Span:
    lines = text.split("\n")
    found = _AT.search(str(error))
    line, column = (int(found[1]), int(found[2])) if found and found[1] else (len(lines), len(lines[-1]) + 1)
    return Span(shown, line, column, 1, lines[line - 1].rstrip("\r") if line <= len(lines) else "")
