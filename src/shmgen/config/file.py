"""Turns shmgen.toml (or `[tool.shmgen]` in pyproject.toml) into a Config, with the line of whatever is wrong."""

from __future__ import annotations

import keyword
import re
from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Any

from shmgen.config import bridging, document, entries
from shmgen.config.bridging import Bridge
from shmgen.config.document import Reader
from shmgen.config.entries import DEFAULT_STRING, ActionEntry, Bound, Bounds, ServiceEntry, TopicEntry
from shmgen.core.diagnostics import Report, Span, closest
from shmgen.core.fast_dataclass import dataclass
from shmgen.core.model import Regions, TypeOptions
from shmgen.targets import KEYS, USUAL

FILE_NAME = "shmgen.toml"
SOURCES = ("jazzy", "humble", "noetic", "kilted", "lyrical", "iron", "galactic", "foxy", "eloquent", "dashing", "env")
MAX_REGION = 32 * 2**20
"""Bytes; more than any sane topic, less than what a forgotten bound makes."""
TASK_INTERVAL = 10
"""Milliseconds between two calls of the generated PROGRAM."""


@dataclass(frozen=True, slots=True)
class Config:
    """The user's words; `root` is the folder that relative paths start from.

    `document` is what was read. `places` says where each of `messages`, `path` and `types_used` is written.
    `sources` are the user's own files of Structured Text.
    Two are said on the command line only: with `skip_unbounded` messages without a bound are left out, and `linked` is
    what other runs have written, each file with its SHA-256, and the messages that they were asked for.
    """

    root: Path
    messages: tuple[str, ...] = ()
    source: str = "jazzy"
    path: tuple[Path, ...] = ()
    targets: tuple[str, ...] = USUAL
    package: str = "shm_msgs"
    distribution: str = ""
    runtime: str = "installed"
    ros_package: str = ""
    document: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)
    max_region: int = MAX_REGION
    task_interval: int = TASK_INTERVAL
    skip_unbounded: bool = False
    linked: Mapping[str, str] = field(default_factory=dict)
    types: TypeOptions = field(default_factory=TypeOptions)
    bounds: Bounds = field(default_factory=lambda: Bounds({}, {}))
    topics: tuple[TopicEntry, ...] = ()
    services: tuple[ServiceEntry, ...] = ()
    actions: tuple[ActionEntry, ...] = ()
    regions: Regions = field(default_factory=Regions)
    bridge: Bridge = field(default_factory=Bridge)
    sources: tuple[Path, ...] = ()
    places: Mapping[str, Span] = field(default_factory=dict)

    @property
    def types_used(self) -> tuple[str, ...]:
        """The types of topics, services and actions, each once."""
        entries: tuple[TopicEntry | ServiceEntry | ActionEntry, ...] = (*self.topics, *self.services, *self.actions)
        return tuple(dict.fromkeys(entry.type for entry in entries))


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
    data, reader = document.read(path, shown, prefix, report)
    config = _Sections(reader).config(data, path.parent)
    report.stop_if_any()
    return replace(config, places=reader.quoted({*config.messages, *config.types_used, *data.get("path", ())}))


@dataclass(frozen=True, slots=True)
class _Sections:
    """What each section of the file may say."""

    read: Reader

    def config(self, data: dict[str, Any], root: Path) -> Config:
        known = (
            "messages",
            "source",
            "path",
            "targets",
            "package",
            "distribution",
            "runtime",
            "max_region",
            "task_interval",
            "ros_package",
        )
        lists = ("topics", "services", "actions")
        self.read.keys("", data, (*known, "types", "strings", "bounds", *lists, "regions", "bridge", "plc"))
        plc = self.read.table(data, "plc")
        self.read.keys("plc", plc, ("sources",))
        types, strings, bounds = (self.read.table(data, name) for name in ("types", "strings", "bounds"))
        self.read.keys("types", types, ("bool", "time", "names"))
        return Config(
            root=root,
            messages=tuple(_from(root, message) for message in self.read.texts("messages", data, ())),
            source=self.read.choice("", "source", data, SOURCES, "jazzy"),
            path=tuple(root / folder for folder in self.read.texts("path", data, ())),
            targets=self.read.texts("targets", data, USUAL, KEYS),
            package=self.package(data),
            distribution=self.distribution(data),
            runtime=self.read.choice("", "runtime", data, ("installed", "beside"), "installed"),
            ros_package=self.ros_package(data),
            document=data,
            max_region=self.read.number("", "max_region", data, MAX_REGION),
            task_interval=self.read.number("", "task_interval", data, TASK_INTERVAL),
            types=TypeOptions(
                bool=self.read.choice("types", "bool", types, ("USINT", "BOOL"), "USINT"),  # type: ignore[arg-type]
                time=self.read.choice("types", "time", types, ("TIME", "LTIME", "struct"), "TIME"),  # type: ignore[arg-type]
                encoding=self.read.choice("strings", "encoding", strings, ("utf-8", "latin-1"), "utf-8"),  # type: ignore[arg-type]
                names=self.read.choice("types", "names", types, ("plc", "ros"), "plc"),  # type: ignore[arg-type]
                overflow=self.read.choice("strings", "overflow", strings, ("error", "truncate"), "error"),  # type: ignore[arg-type]
            ),
            bounds=Bounds(
                strings=self.bound_table("strings", strings, ("default", "encoding", "overflow")),
                sequences=self.bound_table("bounds", bounds, ("default",)),
                default_string=self.read.number("strings", "default", strings, DEFAULT_STRING),
                default_sequence=self.read.number("bounds", "default", bounds, 1) if "default" in bounds else None,
            ),
            topics=entries.topics(self.read, data),
            services=entries.services(self.read, data),
            actions=entries.actions(self.read, data),
            regions=self.regions(self.read.table(data, "regions")),
            bridge=bridging.bridge(self.read, self.read.table(data, "bridge")),
            sources=tuple(root / file for file in self.read.texts("sources", plc, (), section="plc")),
        )

    def regions(self, data: dict[str, Any]) -> Regions:
        self.read.keys("regions", data, ("mode", "group", "sync"))
        mode, group = data.get("mode"), data.get("group", "")
        if mode is not None and not (isinstance(mode, str) and re.fullmatch(_MODE, mode)):
            hint = "whoever opens a region needs to read and write it: 0660 is for owner and group, 0666 for all"
            self.read.wrong("regions", "mode", f"mode is 0600, 0660 or the like, in quotes, not {mode!r}", hint)
            mode = None
        if not isinstance(group, str) or (not group and "group" in data):
            self.read.wrong("regions", "group", f'group is the name of one, such as "plc", not {group!r}')
        sync = self.read.choice("regions", "sync", data, ("lock", "sequence"), "lock")
        return Regions(int(mode, 8) if mode else None, str(group), sync)  # type: ignore[arg-type]

    def bound_table(self, section: str, data: dict[str, Any], options: tuple[str, ...]) -> dict[str, Bound]:
        table: dict[str, Bound] = {}
        for key in data:
            if key in options:
                continue
            close = closest(key, options, 0.8)
            if isinstance(data[key], dict | list):
                hint = 'a key with a slash or a dot stands in quotes: "package/Message.field" = 8'
                if isinstance(data[key], list):
                    hint = f"a key of the whole file stands above the first table: put it above [{section}]"
                self.read.wrong(section, key, f"{key} is a number here", hint)
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

    def ros_package(self, data: dict[str, Any]) -> str:
        name = data.get("ros_package", "")
        if isinstance(name, str) and (not name or re.fullmatch(_ROS_PACKAGE, name)):
            return name
        rule = "small letters, digits and single _, a letter first, two characters at least (REP 144)"
        self.read.wrong("", "ros_package", f"ros_package is made of {rule}, not {name!r}")
        return ""

    def distribution(self, data: dict[str, Any]) -> str:
        value = data.get("distribution", "")
        if isinstance(value, str) and (not value or re.fullmatch(_DISTRIBUTION, value)):
            return value
        example = '"robot-shm 1.2.0"'
        self.read.wrong("", "distribution", f"distribution is a name and a version, such as {example}, not {value!r}")
        return ""


# Compiled where such a key is.
_MODE = r"0?6[06][06]"
"""Who may read a region and not write it cannot enter its lock."""
_ROS_PACKAGE = r"[a-z](_?[a-z0-9])+_?"
_DISTRIBUTION = r"[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])? [0-9]+(\.[0-9]+)*((a|b|rc|\.post|\.dev)[0-9]+)?"
"""Names of PEP 508 and the common versions of PEP 440."""
_BOUND_KEY = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*(\.[A-Za-z]\w*)?)?")


def _from(root: Path, message: str) -> str:
    return str(root / message) if message.endswith((".msg", ".srv", ".action", ".idl")) else message
