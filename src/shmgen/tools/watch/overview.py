"""Describes live regions in rows: `topics`, `info`, `top` and the first screen of `view` show columns of these rows."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from shmgen.core.plural import counted
from shmgen.live.processes import Processes, alive, called
from shmgen.live.processes import look as look_at_processes
from shmgen.live.regions import View, damage, live, missing, topic_of
from shmgen.runtime import region_name
from shmgen.runtime.errors import RegionMissing, ShmError
from shmgen.runtime.region import header as h
from shmgen.runtime.region.header import steps
from shmgen.runtime.region.names import region_file

LISTED = ("topic", "type", "writer", "readers", "slots", "age")
"""Columns of `shmgen topics`."""
DETAILS = (*LISTED, "samples", "missed", "payload", "size", "digest")
COLUMNS = ("topic", "rate", "age", "type", "writer", "slots", "lock", "missed", "recoveries")
"""Columns of `shmgen top`."""
_TEXTS = ("topic", "type", "writer")
_WIDTHS = {"rate": len("1000.0/s"), "age": len("999.9 ms"), "lock": len("1000.0/s")}
"""Usual widths, in characters."""
_NARROWEST = 12
"""Characters that a type or a writer keeps before columns are dropped."""
_MAX_OBSERVATIONS = 6
"""Number of headers from which a rate is computed. With fewer, the rate of a slow topic would flicker to 0."""
_TRIES = 5


@dataclass(frozen=True, slots=True)
class Row:
    """The state of one region: a row in the table of `shmgen top`.

    * `rate` is in samples a second and `lock` in acquisitions a second, both averaged over the last calls of look().
      `lock` is None if one process held the lock during the whole time between two calls.
    * `age` is the seconds since the newest sample, None if unknown. `size` and `payload` are in bytes.
    * `missed` counts the samples that all readers missed since the region was created.
    * `readers` are the pids of all processes that map the region, except the writer and processes that this user cannot
      inspect.
    * If the region is damaged, `type` is the reason, and most other fields are empty.
    """

    topic: str
    type: str
    writer: str = "-"
    slots: int = 0
    age: float | None = None
    missed: int = 0
    size: int = 0
    rate: float | None = None
    lock: float | None = None
    recoveries: int = 0
    readers: tuple[int, ...] = ()
    samples: int = 0
    payload: int = 0
    digest: str = ""

    def plain(self, columns: Sequence[str]) -> dict[str, Any]:
        """Return the fields named in `columns` as data for JSON."""
        return {column: getattr(self, column) for column in columns}


@dataclass(frozen=True, slots=True)
class _Observation:
    """A header that look() has read, to compute rates. `when` is its time in seconds of the monotonic clock."""

    when: float
    header: h.Header
    inode: int


Past = dict[str, deque[_Observation]]
"""Headers that earlier calls of look() have read, by region name."""


def look(past: Past | None = None, processes: Processes | None = None) -> list[Row]:
    """Read the headers of all regions and return a row for each. Without `processes`, the rows list no readers.

    `past` contains the headers that earlier calls have read. look() adds the current headers to `past`, and computes
    the rates from the differences between the earlier and the current headers.
    """
    past = {} if past is None else past
    names, rows = live(), []
    for removed in past.keys() - set(names):
        del past[removed]
    for name in names:
        with suppress(ShmError, OSError), View(name) as view:
            rows.append(_row(view, past, processes))
    return rows


def one(topic: str) -> tuple[Row, bool]:
    """Return the row of a topic, and True if its readers may be incomplete: this user cannot inspect some processes.

    Raises RegionMissing, and PermissionDenied if this user may not read the region.
    """
    around = look_at_processes()
    with suppress(RegionMissing), View(region_name(topic)) as view:
        return _row(view, {}, around), bool(around.hidden and os.geteuid())
    raise missing(topic)


def _row(view: View, past: Past, processes: Processes | None) -> Row:
    header, topic = view.header(), topic_of(view.name)
    readers = set(processes.users(view.status)) - {os.getpid()} if processes else set()
    digest = f"{header.digest:016x}"
    if why := damage(header):
        past.pop(view.name, None)
        return Row(topic, f"damaged: {why}", size=header.size, readers=tuple(sorted(readers)), digest=digest)
    observations = past.setdefault(view.name, deque(maxlen=_MAX_OBSERVATIONS))
    if observations and observations[-1].inode != view.status.st_ino:
        observations.clear()
    observations.append(_Observation(time.monotonic(), header, view.status.st_ino))
    first, earlier = observations[0], observations[-2].header if len(observations) > 1 else None
    seconds = observations[-1].when - first.when
    acquired = (header.lock_count - first.header.lock_count) % 2**32
    is_stuck = earlier and header.lock_holder and header.lock_count == earlier.lock_count
    stamp, writer = _newest_stamp(view, header), view.writer(header.writer) if view.claimed() else None
    return Row(
        topic=topic,
        type=header.type_name,
        writer=writer_of(view, header, earlier),
        slots=header.slots,
        age=max(0.0, (time.time_ns() - stamp) / 1e9) if stamp else None,
        missed=header.missed,
        size=header.size,
        rate=steps(first.header.newest, header.newest, header.slots) / seconds if seconds else None,
        lock=None if is_stuck or not seconds else acquired / seconds,
        recoveries=header.recoveries,
        readers=tuple(sorted(readers - {writer})),
        samples=header.samples,
        payload=header.payload_size,
        digest=digest,
    )


def _newest_stamp(view: View, header: h.Header) -> int | None:
    """Return the stamp of the newest sample; retry if a writer overwrites the sample meanwhile."""
    for _ in range(_TRIES):
        if not header.newest:
            return None
        stamp = view.stamp(header.newest, header)
        if stamp is not None:
            return stamp
        header = view.header()
    return None


def writer_of(view: View, header: h.Header, earlier: h.Header | None) -> str:
    """Return a text about the region's writer: `4242 talker.py`, `PLC`, `PLC, still`, `gone` or `-`.

    `PLC, still` means that the PLC's heartbeat has not changed since the header `earlier`. `gone` means that the writer
    has died, and `-` that the region has no writer.
    """
    if view.claimed():
        name = called(header.writer) if alive(header.writer) else ""
        return f"{header.writer} {name or 'elsewhere'}"  # the process is in another pid namespace
    if header.writer == h.PLC:
        return "PLC, still" if earlier and earlier.heartbeat == header.heartbeat else "PLC"
    return "gone" if header.writer else "-"


def ordered(rows: Sequence[Row], column: str, reverse: bool) -> list[Row]:
    """Return the rows sorted by a column: texts ascending and numbers descending. `reverse` swaps both directions.

    Rows with an unknown value come last.
    """
    known = [row for row in rows if getattr(row, column) is not None]
    known.sort(key=lambda row: row.topic)
    known.sort(key=lambda row: getattr(row, column), reverse=(column not in _TEXTS) != reverse)
    return known + [row for row in rows if getattr(row, column) is None]


def table(
    rows: Collection[Row],
    sorted_by: str | None = None,
    width: int | None = None,
    widths_before: dict[str, int] | None = None,
    columns: Sequence[str] = COLUMNS,
) -> list[str]:
    """Return lines of aligned columns, the titles first. A `*` marks the column `sorted_by`. Fit lines to `width`.

    `widths_before` stores the widths of earlier tables. No column becomes narrower than before, so that no text jumps
    on the screen.
    """
    mark = "" if sorted_by is None else " "
    titles = [f"{name.upper()}{'*' if name == sorted_by else mark}" for name in columns]
    cells = [titles, *([cell(name, getattr(row, name)) for name in columns] for row in rows)]
    before = (_WIDTHS if sorted_by is not None else {}) | (widths_before or {})
    widths = [max(before.get(name, 0), *(len(line[column]) for line in cells)) for column, name in enumerate(columns)]
    if widths_before is not None:
        widths_before.update(zip(columns, widths, strict=True))
    return _align(cells, [columns.index(name) for name in _TEXTS], widths, width)


def _align(rows: Sequence[Sequence[str]], texts: Sequence[int], widths: list[int], width: int | None) -> list[str]:
    """Return lines of aligned columns. `texts` are the indexes of the columns that are left-aligned.

    To fit `width`, shorten the texts except the topic in the first column; then drop columns from the right.
    """
    if width is not None:
        full_widths = widths
        widths = [min(one, _NARROWEST) if column and column in texts else one for column, one in enumerate(full_widths)]
        while len(widths) > 1 and _across(widths) > width:
            widths.pop()
        widths[0] = min(widths[0], width)
        while (short := [at for at in texts[1:] if at < len(widths) and widths[at] < full_widths[at]]) and (
            _across(widths) < width
        ):
            widths[min(short, key=widths.__getitem__)] += 1
    return [
        "  ".join(
            _truncate(cell, most).ljust(most) if column in texts else cell.rjust(most)
            for column, (cell, most) in enumerate(zip(row, widths, strict=False))
        ).rstrip()
        for row in rows
    ]


def _across(widths: Sequence[int]) -> int:
    return sum(widths) + 2 * len(widths) - 2


def _truncate(text: str, most: int) -> str:
    """Shorten a text to `most` characters. Keep the end of a name, and the beginning of a text with blanks."""
    if len(text) <= most:
        return text
    return f"{text[: max(0, most - 3)]}..." if " " in text else f"...{text[max(0, len(text) - most + 3) :]}"


def cell(column: str, value: Any) -> str:
    """Return the text of a value in the table."""
    match column:
        case "rate" | "lock":
            return "-" if value is None else f"{value:.1f}/s"
        case "age":
            return "-" if value is None else _age(value)
        case "readers":
            return str(len(value))
        case _:
            return str(value)


def _age(seconds: float) -> str:
    """Return a duration with a suitable unit: `3.9 ms`, `12.0 s`, `5 min`."""
    if seconds < 1:
        return f"{seconds * 1e3:.1f} ms"
    if seconds < 100:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.0f} h"


def text(row: Row, hidden: bool) -> str:
    """Return the lines that `info` prints for a row. If `hidden` is true, note that readers may be missing."""
    age = "" if row.age is None else f", the newest {_age(row.age)} old"
    return "\n".join(
        [
            f"type: {row.type}",
            f"digest: 16#{row.digest.upper()}",
            f"file: {region_file(region_name(row.topic))}, {counted(row.size, 'byte')}",
            f"payload: {counted(row.payload, 'byte')}, {counted(row.slots, 'slot')}",
            f"samples: {row.samples:,}{age}; {row.missed:,} missed by readers",
            f"writer: {row.writer}",
            f"readers: {len(row.readers)}{'; run with sudo to see hidden readers' if hidden else ''}",
            *(f"  {pid} {called(pid)}" for pid in row.readers),
        ]
    )
