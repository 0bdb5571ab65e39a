"""The rows of `shmgen top`: what all regions did since the last look."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

from shmgen.live.processes import alive, called
from shmgen.live.regions import View, damage, live, topic_of
from shmgen.runtime.errors import ShmError
from shmgen.runtime.region import header as h
from shmgen.runtime.region.header import steps

_LOOKS = 6
"""Rates are over the last so many looks, so that a slow topic does not flicker between 0 and its rate."""


@dataclass(frozen=True, slots=True)
class TopicRow:
    """One region now.

    `rate` is in samples a second, `age` the seconds since the newest one; None where it is not known. `lock` is
    how often a second somebody got inside, None if somebody was inside from the last look to this one. `missed` is
    how many samples its readers have missed, all together and since there is the region; `size` that of its file in
    bytes. Of a damaged one `type` says what is wrong, and nothing else is known.
    """

    topic: str
    rate: float | None
    age: float | None
    type: str
    writer: str
    slots: int
    lock: float | None
    missed: int
    recoveries: int
    size: int = 0

    def plain(self) -> dict[str, Any]:
        return asdict(self)


COLUMNS = tuple(name for name in TopicRow.__dataclass_fields__ if name != "size")
_TEXTS = ("topic", "type", "writer")
_WIDTHS = {"rate": len("1000.0/s"), "age": len("999.9 ms"), "lock": len("1000.0/s")}
"""Characters of what is mostly seen."""
_NARROWEST = 12
"""Characters left of a type or a writer before columns go."""


@dataclass(frozen=True, slots=True)
class _Look:
    """What there was at `when`, by the monotonic clock."""

    when: float
    header: h.Header
    inode: int


Past = dict[str, deque[_Look]]
"""What the looks before saw, by region."""


def look(past: Past) -> list[TopicRow]:
    """A row for each region there is; `past` remembers this look for the next."""
    rows = []
    names = live()
    for gone in past.keys() - set(names):
        del past[gone]
    for name in names:
        with suppress(ShmError, OSError), View(name) as view:
            header = view.header()
            if why := damage(header):
                past.pop(name, None)
                rows.append(TopicRow(topic_of(name), None, None, f"damaged: {why}", "-", 0, None, 0, 0, header.size))
                continue
            looks = past.setdefault(name, deque(maxlen=_LOOKS))
            if looks and looks[-1].inode != view.status.st_ino:
                looks.clear()
            looks.append(_Look(time.monotonic(), header, view.status.st_ino))
            rows.append(_row(view, header, looks))
    return rows


def ordered(rows: Sequence[TopicRow], column: str, reverse: bool) -> list[TopicRow]:
    """Texts from A on, numbers from the greatest on, or the other way round; what is not known comes last."""
    known = [row for row in rows if getattr(row, column) is not None]
    known.sort(key=lambda row: row.topic)
    known.sort(key=lambda row: getattr(row, column), reverse=(column not in _TEXTS) != reverse)
    return known + [row for row in rows if getattr(row, column) is None]


def table(
    rows: Sequence[TopicRow], sorted_by: str = "", width: int | None = None, widths_before: dict[str, int] | None = None
) -> list[str]:
    """Lines of aligned columns, the titles first; the column sorted by carries a `*`.

    No column becomes narrower than in the tables before, whose widths are remembered in `widths_before`: nothing jumps.
    """
    titles = [f"{name.upper()}{'*' if name == sorted_by else ' '}" for name in COLUMNS]
    cells = [titles, *([cell(name, getattr(row, name)) for name in COLUMNS] for row in rows)]
    before = _WIDTHS if widths_before is None else _WIDTHS | widths_before
    widths = [max(before.get(name, 0), *(len(line[column]) for line in cells)) for column, name in enumerate(COLUMNS)]
    if widths_before is not None:
        widths_before.update(zip(COLUMNS, widths, strict=True))
    return aligned(cells, [COLUMNS.index(name) for name in _TEXTS], widths, width)


def aligned(rows: Sequence[Sequence[str]], texts: Sequence[int], widths: list[int], width: int | None) -> list[str]:
    """Lines of columns, `texts` to the left.

    To fit `width`, texts but the topic in the first column are shortened; then columns go from the right.
    """
    if width is not None:
        wanted = widths
        widths = [min(room, _NARROWEST) if column and column in texts else room for column, room in enumerate(wanted)]
        while len(widths) > 1 and _across(widths) > width:
            widths.pop()
        widths[0] = min(widths[0], width)
        while (short := [at for at in texts[1:] if at < len(widths) and widths[at] < wanted[at]]) and (
            _across(widths) < width
        ):
            widths[min(short, key=widths.__getitem__)] += 1
    return [
        "  ".join(
            _cut(cell, room).ljust(room) if column in texts else cell.rjust(room)
            for column, (cell, room) in enumerate(zip(row, widths, strict=False))
        ).rstrip()
        for row in rows
    ]


def writer_of(view: View, header: h.Header, earlier: h.Header | None) -> str:
    """`4242 talker.py`, `PLC`, `PLC, still` if its heartbeat did not move since `earlier`, `gone`, `-`."""
    if view.claimed():
        name = called(header.writer) if alive(header.writer) else ""
        return f"{header.writer} {name or 'elsewhere'}"  # of another pid namespace
    if header.writer == h.PLC:
        return "PLC, still" if earlier and earlier.heartbeat == header.heartbeat else "PLC"
    return "gone" if header.writer else "-"


def _across(widths: Sequence[int]) -> int:
    return sum(widths) + 2 * len(widths) - 2


def _cut(text: str, room: int) -> str:
    """Of a name the end stays, of a sentence the beginning."""
    if len(text) <= room:
        return text
    return f"{text[: max(0, room - 3)]}..." if " " in text else f"...{text[max(0, len(text) - room + 3) :]}"


def _row(view: View, header: h.Header, looks: Sequence[_Look]) -> TopicRow:
    first, last = looks[0], looks[-1]
    earlier = looks[-2].header if len(looks) > 1 else None
    seconds = last.when - first.when
    written = steps(first.header.newest, header.newest, header.slots)
    stamp = view.stamp(header.newest, header) if header.newest else None
    entered = (header.lock_count - first.header.lock_count) % 2**32
    stuck = earlier and header.lock_holder and header.lock_count == earlier.lock_count
    return TopicRow(
        topic=topic_of(view.name),
        rate=written / seconds if seconds else None,
        age=max(0.0, (time.time_ns() - stamp) / 1e9) if stamp else None,
        type=header.type_name,
        writer=writer_of(view, header, earlier),
        slots=header.slots,
        lock=None if stuck or not seconds else entered / seconds,
        missed=header.missed,
        recoveries=header.recoveries,
        size=header.size,
    )


def cell(column: str, value: Any) -> str:
    """What the table shows of it."""
    match column:
        case "rate" | "lock":
            return "-" if value is None else f"{value:.1f}/s"
        case "age":
            return "-" if value is None else age_of(value)
        case _:
            return str(value)


def age_of(seconds: float) -> str:
    """`3.9 ms`, `12.0 s`, `5 min`."""
    if seconds < 1:
        return f"{seconds * 1e3:.1f} ms"
    if seconds < 100:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.0f} h"
