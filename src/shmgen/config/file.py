"""Reads shmgen.toml (or `[tool.shmgen]` in pyproject.toml) into a Config; whatever is wrong has its line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Any

from shmgen.config import document, entries
from shmgen.config.bridging import Bridge
from shmgen.config.document import Reader
from shmgen.config.entries import ActionEntry, Bound, Bounds, ServiceEntry, TopicEntry
from shmgen.config.keys import BOUND_KEY, LISTS, MAX_REGION, SECTIONS, of
from shmgen.core.diagnostics import Report, Span, closest
from shmgen.core.fast_dataclass import dataclass
from shmgen.core.model import Regions, TypeOptions
from shmgen.targets import USUAL

FILE_NAME = "shmgen.toml"


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
    task_interval: int = 10
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
        top = self.read.values("", data)
        tables = {name: self.read.table(data, name) for name in SECTIONS if name not in LISTS}
        said = {name: self.read.values(name, table) for name, table in tables.items()}
        strings, regions = said["strings"], said["regions"]
        mode = regions["mode"]
        return Config(
            **top
            | {
                "root": root,
                "messages": tuple(_from(root, message) for message in top["messages"]),
                "path": tuple(root / folder for folder in top["path"]),
            },
            document=data,
            types=TypeOptions(**said["types"], encoding=strings["encoding"], overflow=strings["overflow"]),
            bounds=Bounds(
                strings=self.bound_table("strings", tables["strings"]),
                sequences=self.bound_table("bounds", tables["bounds"]),
                default_string=strings["default"],
                default_sequence=said["bounds"]["default"],
            ),
            topics=entries.topics(self.read, data),
            services=entries.services(self.read, data),
            actions=entries.actions(self.read, data),
            regions=Regions(int(mode, 8) if mode else None, regions["group"], regions["sync"]),
            bridge=Bridge(**said["bridge"]),
            sources=tuple(root / file for file in said["plc"]["sources"]),
        )

    def bound_table(self, section: str, data: dict[str, Any]) -> dict[str, Bound]:
        options, table = tuple(key.name for key in of(section)), dict[str, Bound]()
        for key in data:
            if key in options:
                continue
            close = closest(key, options, 0.8)
            if isinstance(data[key], dict | list):
                hint = 'a key with a slash or a dot stands in quotes: "package/Message.field" = 8'
                if isinstance(data[key], list):
                    hint = f"a key of the whole file stands above the first table: put it above [{section}]"
                self.read.wrong(section, key, f"{key} is a number here", hint)
            elif close or not re.fullmatch(BOUND_KEY, key):
                hint = 'a key here is "package/Message.field", "package/Message" or "package"'
                hint += f", or one of {', '.join(options)}"
                hint = f"did you mean {close}?" if close else hint
                self.read.report.error(
                    "SHM501", f"unknown key {key} in [{section}]", self.read.span(section, key), hint=hint
                )
            else:
                table[key] = Bound(self.read.number(section, key, data), self.read.span(section, key))
        return table


def _from(root: Path, message: str) -> str:
    return str(root / message) if message.endswith((".msg", ".srv", ".action", ".idl")) else message
