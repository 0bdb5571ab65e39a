"""Read `[[topics]]`, `[[services]]` and `[[actions]]` of shmgen.toml, and report errors with their lines."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, Literal, NamedTuple, TypeAlias

from shmgen.config.document import Reader
from shmgen.core import abi
from shmgen.core.diagnostics import Span

DEFAULT_STRING = 80
"""The default bound of a string. It is the same as in CODESYS, where STRING means STRING(80)."""


class Bound(NamedTuple):
    """One line of `[bounds]` or `[strings]`: the number, and the line's position in shmgen.toml for diagnostics."""

    value: int
    span: Span


class Bounds(NamedTuple):
    """The bounds of strings and sequences, from `[strings]` and `[bounds]` of shmgen.toml.

    Keys are `package/Message.field`, `package/Message` or `package`. The most specific key wins. A bound in the
    definition wins over all keys.
    """

    strings: Mapping[str, Bound]
    sequences: Mapping[str, Bound]
    default_string: int = DEFAULT_STRING
    default_sequence: int | None = None


class TransferOptions(NamedTuple):
    """The settings with which the bridge transfers a topic.

    `rate` is in Hz, and None means no limit. `stale` is in seconds, and None means that data never becomes stale.
    config/keys.py describes each setting.
    """

    rate: float | None = None
    qos: Literal["auto", "reliable", "best_effort"] = "auto"
    latch: bool = False
    stamp: Literal["now", "keep"] = "now"
    overflow: Literal["reject", "truncate"] = "reject"
    stale: float | None = None
    other_definition: Literal["refuse", "accept"] = "refuse"


class TopicEntry(NamedTuple):
    """One `[[topics]]` entry. Slow readers can read the newest `depth` samples. `carried` has the bridge's settings."""

    topic: str
    type: str
    direction: str
    depth: int
    span: Span
    carried: TransferOptions = TransferOptions()


class CallEntry(NamedTuple):
    """One `[[services]]` or `[[actions]]` entry. `server` is `plc` or `ros`.

    The bridge waits `timeout` seconds for the response of a service, or until a goal of an action is accepted.
    """

    name: str
    type: str
    server: str
    timeout: float
    span: Span


def topics(read: Reader, data: dict[str, Any]) -> tuple[TopicEntry, ...]:
    """Read all [[topics]]. Reports invalid entries as SHM501 or SHM502."""
    return tuple(_topic(read, *entry) for entry in _entries(read, data, "topics", abi.MAX_NAME))


def calls(read: Reader, data: dict[str, Any], list_name: str) -> tuple[CallEntry, ...]:
    """Read all [[services]] or all [[actions]]. Reports invalid entries as SHM501 or SHM502."""
    return tuple(
        CallEntry(values[list_name.removesuffix("s")], values["type"], values["server"], values["timeout"], span)
        for _, _, values, span in _entries(read, data, list_name, abi.MAX_CALL_NAME)
    )


_MESSAGE = re.compile(r"[A-Za-z]\w*/((msg|srv|action)/)?[A-Za-z]\w*", re.ASCII)


_Entry: TypeAlias = tuple[str, dict[str, Any], dict[str, Any], Span]
"""The section of a table for the Reader, such as `topics.0`, the table, its values with defaults, and its position."""


def _entries(read: Reader, data: dict[str, Any], list_name: str, longest: int) -> Iterator[_Entry]:
    """Check the names and types in the list `list_name`, such as `topics`, and yield one _Entry for each table.

    A name may have at most `longest` characters.
    """
    kind = list_name.removesuffix("s")
    tables = data.get(list_name, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        read.wrong("", list_name, f"{list_name} must be a list of tables: write [[{list_name}]]")
        return
    seen: set[str] = set()
    for index, table in enumerate(tables):
        section = f"{list_name}.{index}"
        values = read.values(section, table)
        for key in (kind, "type"):
            if key not in table:
                read.wrong(section, "", f'{key} is missing: add {key} = "..." to this [[{list_name}]] entry')
        name, type = str(table.get(kind)), str(table.get("type"))
        if isinstance(table.get(kind), str) and (why := _not_a_name(name, longest)):
            read.wrong(section, kind, f"{kind} {name} {why}")
        if isinstance(table.get("type"), str) and not _MESSAGE.fullmatch(type):
            what = {"topic": "a message", "service": "a service"}.get(kind, "an action")
            read.wrong(section, "type", f"type {type} is not {what}: write package/Name")
        yield section, table, values, read.span(section, kind)
        if name.removeprefix("/") in seen:
            read.wrong(section, kind, f"{kind} {name} is listed twice")
        if kind in table:
            seen.add(name.removeprefix("/"))


def _topic(read: Reader, section: str, table: dict[str, Any], values: dict[str, Any], span: Span) -> TopicEntry:
    """Return the topic of one `[[topics]]` entry. Reports SHM502 if the direction excludes a setting of the bridge."""
    for key, towards in (("stamp", "from_plc"), ("overflow", "to_plc"), ("other_definition", "to_plc")):
        if key in table and values["direction"] != towards:
            read.wrong(section, key, f'{key} is valid only with direction = "{towards}"')
    carried = TransferOptions(**{name: values[name] for name in TransferOptions._fields})
    return TopicEntry(values["topic"], values["type"], values["direction"], values["depth"], span, carried)


def _not_a_name(name: str, longest: int) -> str:
    """Return why a region cannot have the name, or ""."""
    bare = name.removeprefix("/")
    if not re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", bare, re.ASCII):
        return "must have letters, digits and _ between single slashes, and no part that begins with a digit"
    if len(bare) > longest:
        return f"has {len(bare)} characters, but only {longest} and a suffix fit into a STRING(80)"
    if bare.upper() in _RESERVED:
        return f"is reserved, because CODESYS uses it in /dev/shm ({bare}*)"
    return "begins with sem/, which Linux reserves for semaphores" if bare.startswith("sem/") else ""


_RESERVED = ("CME", "GWDRVSHAREDMEMSHM", "RETAINMEMORY")
"""Prefixes that CODESYS uses; the same as in runtime/region/names.py."""
