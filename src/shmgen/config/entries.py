"""Reads bounds, `[[topics]]`, `[[services]]` and `[[actions]]` of shmgen.toml; a mistake has its line."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Any, NamedTuple

from shmgen.config import bridging
from shmgen.config.bridging import Carrying
from shmgen.config.document import Reader
from shmgen.core import abi
from shmgen.core.diagnostics import Span
from shmgen.core.fast_dataclass import dataclass

DEFAULT_STRING = 80
"""CODESYS's own default, STRING = STRING(80)."""


@dataclass(frozen=True, slots=True)
class Bound:
    """One line of `[bounds]` or `[strings]`: the number, and where it was written."""

    value: int
    span: Span


@dataclass(frozen=True, slots=True)
class Bounds:
    """`[strings]` and `[bounds]` of shmgen.toml.

    Keys are `package/Message.field`, `package/Message` or `package`; the most specific wins, and a bound in
    the definition wins over all of them.
    """

    strings: Mapping[str, Bound]
    sequences: Mapping[str, Bound]
    default_string: int = DEFAULT_STRING
    default_sequence: int | None = None


@dataclass(frozen=True, slots=True)
class TopicEntry:
    """One `[[topics]]` entry: `depth` is how many samples a slow reader can still fetch, `carried` the rest."""

    topic: str
    type: str
    direction: str
    depth: int
    span: Span
    carried: Carrying = field(default_factory=Carrying)


@dataclass(frozen=True, slots=True)
class ServiceEntry:
    """One `[[services]]` entry: `server` is `plc` or `ros`, `timeout` what the bridge waits for the PLC, in seconds."""

    service: str
    type: str
    server: str
    timeout: float
    span: Span


@dataclass(frozen=True, slots=True)
class ActionEntry:
    """One `[[actions]]` entry: as a service; `timeout` is for a word on whether a goal is accepted."""

    action: str
    type: str
    server: str
    timeout: float
    span: Span


def topics(read: Reader, data: dict[str, Any]) -> tuple[TopicEntry, ...]:
    """Reports SHM501, SHM502; so do the others."""
    return tuple(_topic(read, entry) for entry in _entries(read, data, "topics", abi.MAX_NAME))


def services(read: Reader, data: dict[str, Any]) -> tuple[ServiceEntry, ...]:
    return tuple(
        ServiceEntry(entry.name, entry.type, entry.values["server"], entry.values["timeout"], entry.span)
        for entry in _entries(read, data, "services", abi.MAX_CALL_NAME)
    )


def actions(read: Reader, data: dict[str, Any]) -> tuple[ActionEntry, ...]:
    return tuple(
        ActionEntry(entry.name, entry.type, entry.values["server"], entry.values["timeout"], entry.span)
        for entry in _entries(read, data, "actions", abi.MAX_CALL_NAME)
    )


class _Entry(NamedTuple):
    """`section` is what the reader calls the table, `topics.0`."""

    section: str
    table: dict[str, Any]
    values: dict[str, Any]
    name: str
    type: str
    span: Span


_MESSAGE = re.compile(r"[A-Za-z]\w*/((msg|srv|action)/)?[A-Za-z]\w*", re.ASCII)


def _entries(read: Reader, data: dict[str, Any], list_name: str, longest: int) -> Iterator[_Entry]:
    """The tables of one list, the name and the type of each looked at."""
    kind = list_name.removesuffix("s")
    tables = data.get(list_name, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        read.wrong("", list_name, f"{list_name} is a list of tables: write [[{list_name}]]")
        return
    seen: set[str] = set()
    for index, table in enumerate(tables):
        section = f"{list_name}.{index}"
        values = read.values(section, table)
        for key in (kind, "type"):
            if key not in table:
                read.report.error("SHM502", f'a [[{list_name}]] entry needs {key} = "..."', read.span(section, ""))
        name, type = str(table.get(kind)), str(table.get("type"))
        if isinstance(table.get(kind), str) and (why := _not_a_name(name, longest)):
            read.wrong(section, kind, f"{kind} {name} {why}")
        if isinstance(table.get("type"), str) and not _MESSAGE.fullmatch(type):
            what = "message" if kind == "topic" else kind
            read.wrong(section, "type", f"type {type} names no {what}: write package/Name")
        span = read.span(section, kind)
        yield _Entry(section, table, values, name, type, span)
        if name.removeprefix("/") in seen:
            read.report.error("SHM502", f"{kind} {name} is listed twice", span)
        if kind in table:
            seen.add(name.removeprefix("/"))


def _topic(read: Reader, entry: _Entry) -> TopicEntry:
    carried = bridging.carrying(read, entry.section, entry.table, entry.values)
    return TopicEntry(entry.name, entry.type, entry.values["direction"], entry.values["depth"], entry.span, carried)


def _not_a_name(name: str, longest: int) -> str:
    """Why a PLC cannot have it, or nothing."""
    bare = name.removeprefix("/")
    if not re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", bare, re.ASCII):
        return "needs letters, digits and _ between single slashes, no digit first"
    if len(bare) > longest:
        return f"has {len(bare)} characters, more than the {longest} of a STRING(80) and its suffix"
    if bare.upper() in _TAKEN:
        return f"is a name that CODESYS keeps in /dev/shm for itself ({bare}*)"
    return "begins with sem/, where Linux keeps the semaphores" if bare.startswith("sem/") else ""


_TAKEN = ("CME", "GWDRVSHAREDMEMSHM", "RETAINMEMORY")
"""As runtime/region/names.py has them."""
