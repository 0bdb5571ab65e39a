"""Read shmgen.toml, or `[tool.shmgen]` in pyproject.toml, into a Config. Errors give the line in the file."""

from __future__ import annotations

import re
import stat
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from shmgen.config import document, entries
from shmgen.config.document import Reader
from shmgen.config.entries import Bound, Bounds, CallEntry, TopicEntry
from shmgen.config.keys import BOUND_KEY, LISTS, MAX_REGION, SECTIONS, keys_of
from shmgen.core.diagnostics import Report, Span, closest
from shmgen.core.model import Regions, TypeOptions
from shmgen.targets import USUAL

FILE_NAME = "shmgen.toml"


class Bridge(NamedTuple):
    """The table `[bridge]` of shmgen.toml.

    `diagnostics` is the seconds between two messages on /diagnostics, or 0 for no messages. `domain` is the DDS domain.
    None selects the domain in ROS_DOMAIN_ID.
    """

    backend: str = "auto"
    node: str = "shmgen_bridge"
    diagnostics: float = 1.0
    domain: int | None = None


@dataclass(frozen=True, slots=True)
class Config:
    """The configuration of a run: the content of shmgen.toml, and two settings of the command line.

    * Relative paths start from the folder `root`. `document` is the parsed file.
    * `places` maps each message, search folder and type in shmgen.toml to its position in the file.
    * `sources` are the user's own files of Structured Text.
    * `skip_unbounded` is true if the command line has --skip-unbounded, which drops messages with unbounded fields.
    * `linked` describes the output folders of other runs, which the command line names with --link. It maps the path
      of each generated file to its SHA-256, and the name of each requested message to `""`.
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
    services: tuple[CallEntry, ...] = ()
    actions: tuple[CallEntry, ...] = ()
    regions: Regions = field(default_factory=Regions)
    bridge: Bridge = field(default_factory=Bridge)
    sources: tuple[Path, ...] = ()
    places: Mapping[str, Span] = field(default_factory=dict)

    @property
    def types_used(self) -> tuple[str, ...]:
        """The types of topics, services and actions, each once."""
        entries: tuple[TopicEntry | CallEntry, ...] = (*self.topics, *self.services, *self.actions)
        return tuple(dict.fromkeys(entry.type for entry in entries))


def find(start: Path) -> Path | None:
    """Return the configuration file in the folder `start`, or None. shmgen.toml precedes pyproject.toml.

    Raises PermissionError if the folder or a file is not accessible.
    """
    if _is_file(start / FILE_NAME):
        return start / FILE_NAME
    project = start / "pyproject.toml"
    if _is_file(project) and b"[tool.shmgen" in project.read_bytes():
        return project
    return None


def _is_file(path: Path) -> bool:
    """Return True if a file exists. Raises PermissionError if the folder is not accessible.

    Path.is_file() of Python 3.14 would return False for such a folder.
    """
    with suppress(FileNotFoundError, NotADirectoryError):
        return stat.S_ISREG(path.stat().st_mode)
    return False


def load(path: Path, shown_path: str, report: Report) -> Config:
    """Read the configuration file `path`. Diagnostics show the path as `shown_path`.

    Raises Rejected: SHM001, SHM002, SHM501, SHM502, SHM503.
    """
    prefix = "tool.shmgen" if path.name == "pyproject.toml" else ""
    data, reader = document.read(path, shown_path, prefix, report)
    config = _config(reader, data, path.parent)
    report.stop_if_any()
    words = {*config.messages, *config.types_used, *data.get("path", ())}
    return replace(config, places=document.quoted(reader.text, shown_path, words))


def _config(read: Reader, data: dict[str, Any], root: Path) -> Config:
    top = read.values("", data)
    tables = {name: read.table(data, name) for name in SECTIONS if name not in LISTS}
    values = {name: read.values(name, table) for name, table in tables.items()}
    strings, regions = values["strings"], values["regions"]
    mode = regions["mode"]
    top["messages"] = tuple(_from(root, message) for message in top["messages"])
    top["path"] = tuple(root / folder for folder in top["path"])
    return Config(
        root,
        **top,
        document=data,
        types=TypeOptions(**values["types"], encoding=strings["encoding"], overflow=strings["overflow"]),
        bounds=Bounds(
            strings=_bound_table(read, "strings", tables["strings"]),
            sequences=_bound_table(read, "bounds", tables["bounds"]),
            default_string=strings["default"],
            default_sequence=values["bounds"]["default"],
        ),
        topics=entries.topics(read, data),
        services=entries.calls(read, data, "services"),
        actions=entries.calls(read, data, "actions"),
        regions=Regions(int(mode, 8) if mode else None, regions["group"], regions["sync"]),
        bridge=Bridge(**values["bridge"]),
        sources=tuple(root / file for file in values["plc"]["sources"]),
    )


def _bound_table(read: Reader, section: str, data: dict[str, Any]) -> dict[str, Bound]:
    options, table = tuple(key.name for key in keys_of(section)), dict[str, Bound]()
    for key in data:
        if key in options:
            continue
        close = closest(key, options, 0.8)
        if isinstance(data[key], dict | list):
            hint = 'put a key with a slash or a dot in quotes: "package/Message.field" = 8'
            if isinstance(data[key], list):
                hint = f"move this key above [{section}]: a key of the whole file stands above the first table"
            read.wrong(section, key, f"{key} must be a number", hint)
        elif close or not re.fullmatch(BOUND_KEY, key):
            hint = 'write "package/Message.field", "package/Message" or "package"'
            hint += f", or one of {', '.join(options)}"
            hint = f"did you mean {close}?" if close else hint
            read.report.error("SHM501", f"unknown key {key} in [{section}]", read.span(section, key), hint=hint)
        else:
            table[key] = Bound(read.number(section, key, data), read.span(section, key))
    return table


def _from(root: Path, message: str) -> str:
    return str(root / message) if message.endswith((".msg", ".srv", ".action", ".idl")) else message
