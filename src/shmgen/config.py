"""Turns shmgen.toml (or `[tool.shmgen]` in pyproject.toml) into a Config, with the line of whatever is wrong."""

from __future__ import annotations

import keyword
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from shmgen import config_bridge, config_reader
from shmgen.bounds import DEFAULT_STRING, Bound, Bounds
from shmgen.config_bridge import CARRYING, Bridge, Carrying
from shmgen.config_reader import Reader
from shmgen.diagnostics import Report, Span, closest
from shmgen.model import TypeOptions

FILE_NAME = "shmgen.toml"
TARGETS = ("python", "st", "plcopen", "c")
SOURCES = ("jazzy", "humble", "noetic", "kilted", "lyrical", "iron", "galactic", "foxy", "eloquent", "dashing", "env")
MAX_REGION = 16 * 2**20
"""Bytes; more than any sane topic, less than what a forgotten bound makes."""
TASK_INTERVAL = 10
"""Milliseconds between two calls of the generated PROGRAM."""
MAX_DEPTH = 65535
"""MAX_DEPTH of FB_ShmRegion."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One `[[topics]]` entry: `depth` is how many samples a slow reader can still fetch, `carried` the rest."""

    topic: str
    type: str
    direction: str
    depth: int
    span: Span
    carried: Carrying = field(default_factory=Carrying)


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
    bridge: Bridge = field(default_factory=Bridge)
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
    prefix = "tool.shmgen" if path.name == "pyproject.toml" else ""
    data, reader = config_reader.read(path, shown, prefix, report)
    config = _Sections(reader).config(data, path.parent)
    report.stop_if_any()
    return replace(config, places=reader.quoted({*config.messages, *(topic.type for topic in config.topics)}))


@dataclass(frozen=True, slots=True)
class _Sections:
    """What each section of the file may say."""

    read: Reader

    def config(self, data: dict[str, Any], root: Path) -> Config:
        known = ("messages", "source", "path", "targets", "package", "distribution", "max_region", "task_interval")
        self.read.keys("", data, (*known, "types", "strings", "bounds", "topics", "bridge"))
        types, strings, bounds = (self.read.table(data, name) for name in ("types", "strings", "bounds"))
        self.read.keys("types", types, ("bool", "time"))
        return Config(
            root=root,
            messages=tuple(_from(root, message) for message in self.read.texts("messages", data, ())),
            source=self.read.choice("", "source", data, SOURCES, "jazzy"),
            path=tuple(root / folder for folder in self.read.texts("path", data, ())),
            targets=self.read.texts("targets", data, TARGETS, TARGETS),
            package=self.package(data),
            distribution=self.distribution(data),
            max_region=self.read.number("", "max_region", data, MAX_REGION),
            task_interval=self.read.number("", "task_interval", data, TASK_INTERVAL),
            types=TypeOptions(
                bool=self.read.choice("types", "bool", types, ("USINT", "BOOL"), "USINT"),  # type: ignore[arg-type]
                time=self.read.choice("types", "time", types, ("TIME", "LTIME", "struct"), "TIME"),  # type: ignore[arg-type]
                encoding=self.read.choice("strings", "encoding", strings, ("utf-8", "latin-1"), "utf-8"),  # type: ignore[arg-type]
                overflow=self.read.choice("strings", "overflow", strings, ("error", "truncate"), "error"),  # type: ignore[arg-type]
            ),
            bounds=Bounds(
                strings=self.bound_table("strings", strings, ("default", "encoding", "overflow")),
                sequences=self.bound_table("bounds", bounds, ()),
                default_string=self.read.number("strings", "default", strings, DEFAULT_STRING),
            ),
            topics=self.topics(data),
            bridge=config_bridge.bridge(self.read, self.read.table(data, "bridge")),
        )

    def topics(self, data: dict[str, Any]) -> tuple[Topic, ...]:
        entries = data.get("topics", [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            self.read.wrong("", "topics", "topics is a list of tables: write [[topics]]")
            return ()
        topics: list[Topic] = []
        for index, entry in enumerate(entries):
            section = f"topics.{index}"
            self.read.keys(section, entry, ("topic", "type", "direction", "depth", *CARRYING))
            for key in ("topic", "type"):
                if key not in entry:
                    self.read.report.error(
                        "SHM502", f'a [[topics]] entry needs {key} = "..."', self.read.span(section, "")
                    )
                elif not isinstance(entry[key], str):
                    self.read.wrong(section, key, f"{key} is a string, not {entry[key]!r}")
            direction = self.read.choice(section, "direction", entry, ("to_plc", "from_plc"), "to_plc")
            depth = self.read.number(section, "depth", entry, 1, MAX_DEPTH)
            span = self.read.span(section, "topic")
            if isinstance(entry.get("topic"), str) and (why := _not_a_topic(entry["topic"])):
                self.read.wrong(section, "topic", f"topic {entry['topic']} {why}")
            if isinstance(entry.get("type"), str) and not _MESSAGE.fullmatch(entry["type"]):
                self.read.wrong(section, "type", f"type {entry['type']} names no message: write package/Name")
            carried = config_bridge.carrying(self.read, section, entry, direction)
            topics.append(Topic(str(entry.get("topic")), str(entry.get("type")), direction, depth, span, carried))
            if any(topic.topic == entry.get("topic") for topic in topics[:-1]):
                self.read.report.error("SHM502", f"topic {entry.get('topic')} is listed twice", span)
        return tuple(topics)

    def bound_table(self, section: str, data: dict[str, Any], options: tuple[str, ...]) -> dict[str, Bound]:
        table: dict[str, Bound] = {}
        for key in data:
            if key in options:
                continue
            close = closest(key, options, 0.8)
            if isinstance(data[key], dict):
                hint = 'a key with a slash or a dot stands in quotes: "package/Message.field" = 8'
                self.read.report.error(
                    "SHM502", f"{key} is a number, not a table", self.read.span(section, key), hint=hint
                )
            elif close or not _BOUND_KEY.fullmatch(key):
                hint = 'a key here is "package/Message.field", "package/Message" or "package"'
                hint += f", or one of {', '.join(options)}" if options else ""
                hint = f"did you mean {close}?" if close else hint
                self.read.report.error(
                    "SHM501", f"unknown key {key} in [{section}]", self.read.span(section, key), hint=hint
                )
            else:
                table[key] = Bound(self.read.number(section, key, data, 1), self.read.span(section, key))
        return table

    def package(self, data: dict[str, Any]) -> str:
        name = data.get("package", "shm_msgs")
        usable = isinstance(name, str) and name.isascii() and name.isidentifier() and not keyword.iskeyword(name)
        if not usable or name == "shmgen":  # that one is imported by what is generated
            self.read.wrong(
                "", "package", f'package names the Python package to make, such as "shm_msgs", not {name!r}'
            )
            return "shm_msgs"
        return str(name)

    def distribution(self, data: dict[str, Any]) -> str:
        value = data.get("distribution", "")
        if isinstance(value, str) and (not value or _DISTRIBUTION.fullmatch(value)):
            return value
        example = '"robot-shm 1.2.0"'
        self.read.wrong("", "distribution", f"distribution is a name and a version, such as {example}, not {value!r}")
        return ""


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


def _from(root: Path, message: str) -> str:
    return str(root / message) if message.endswith((".msg", ".srv", ".action")) else message
