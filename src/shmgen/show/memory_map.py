"""Draw the memory of a message as SVG: 8 bytes in a line, one colour for each field."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

from shmgen.core.model import Layout, Layouts, Output
from shmgen.core.plural import counted
from shmgen.show.table import Row, leaves

BYTES_PER_LINE = 8
MAX_LINES = 3
"""Largest number of lines for one field. A longer field is drawn shortened."""
_ELLIPSIS = "\u2026"
_COLOURS = 8
_CELL, _LINE, _LEFT, _TOP = 74, 34, 64, 84
_CHARACTER = 7
"""Lengths in pixels: width of a byte, height of a line, left and top margin, and width of a character."""


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of the drawing, in pixels: the bytes of one field in one line.

    `style` is a class of the drawing's style sheet. `label` is the text in the rectangle, `title` the tooltip.
    """

    x: int
    y: int
    width: int
    height: int
    style: str
    label: str
    title: str


@dataclass(frozen=True, slots=True)
class Mark:
    """A text of the drawing and its position in pixels."""

    x: int
    y: int
    text: str


@dataclass(frozen=True, slots=True)
class MemoryMap:
    """The template data for the drawing of one message. All strings are safe for XML."""

    title: str
    subtitle: str
    width: int
    height: int
    columns: tuple[Mark, ...]
    offsets: tuple[Mark, ...]
    boxes: tuple[Box, ...]


def plan(layout: Layout, layouts: Layouts) -> Output:
    """Return the template and the data for a drawing of a message's memory.

    Draw nested messages, which `layouts` contains, as their fields. Shorten long arrays.
    """
    boxes = leaves(layout, layouts)
    fields = dict.fromkeys(_field(row) for row in boxes if row.role in ("data", "count"))
    styles = {field: f"c{index % _COLOURS}" for index, field in enumerate(fields)}
    lines = _lines(boxes, layout.size)
    places = {first: index for index, (first, _) in enumerate(lines)}
    view = MemoryMap(
        title=escape(str(layout.name)),
        subtitle=escape(f"{counted(layout.size, 'byte')}, alignment {layout.align}, digest {layout.digest:016x}"),
        width=_LEFT + BYTES_PER_LINE * _CELL + 24,
        height=_TOP + len(lines) * _LINE + 20,
        columns=tuple(Mark(_LEFT + i * _CELL + _CELL // 2, _TOP - 8, f"+{i}") for i in range(BYTES_PER_LINE)),
        offsets=tuple(
            Mark(_LEFT - 10, _TOP + place * _LINE + 21, str(first * BYTES_PER_LINE)) for first, place in places.items()
        ),
        boxes=tuple(
            _box(
                row, line, _TOP + place * _LINE, "padding" if row.role in ("padding", "filler") else styles[_field(row)]
            )
            for place, line in enumerate(lines)
            for row in boxes
            if row.offset < (line[1] + 1) * BYTES_PER_LINE and row.offset + row.size > line[0] * BYTES_PER_LINE
        ),
    )
    return Output("memory_map.svg", "show/memory_map.svg.j2", view)


def _box(row: Row, line: tuple[int, int], y: int, style: str) -> Box:
    """Return the rectangle for the bytes of `row` in one line of the drawing. The line begins at `y` pixels.

    `row` is a field, count or padding. `line` contains the numbers of the first and the last 8-byte group of memory
    that the line shows. `style` is the class in the style sheet.
    """
    first, last = line
    start = max(row.offset, first * BYTES_PER_LINE)
    stop = min(row.offset + row.size, (last + 1) * BYTES_PER_LINE)
    width = (BYTES_PER_LINE if last > first else stop - start) * _CELL - 2
    label = ""
    if last > first:
        label = f"\u22ee {counted(stop - start, 'byte')}"
    elif row.role != "padding":
        label = _label(row, first, width)
    title = f"{row.path}: {row.ros or row.role}, {row.iec}, offset {row.offset}, {counted(row.size, 'byte')}"
    x = _LEFT + start % BYTES_PER_LINE * _CELL + 1
    return Box(x, y + 1, width, _LINE - 2, style, escape(label), escape(title))


def _field(row: Row) -> str:
    """Return the name of the outermost field to which a row belongs, such as `position` for `position.x`.

    A count belongs to its sequence.
    """
    return row.path.partition(".")[0].removesuffix("_count" if row.role == "count" else "")


def _lines(boxes: list[Row], size: int) -> list[tuple[int, int]]:
    """Return the numbers of the first and the last 8-byte group of memory that each line of the drawing shows.

    A line normally shows one group. A long array gets three lines: the first group, all inner groups, the last group.
    """
    spans = [(-(-row.offset // BYTES_PER_LINE), (row.offset + row.size) // BYTES_PER_LINE) for row in boxes]
    long = {first: stop for first, stop in spans if stop - first > MAX_LINES}
    lines: list[tuple[int, int]] = []
    line = 0
    while line < -(-size // BYTES_PER_LINE):
        if line in long:
            lines += [(line, line), (line + 1, long[line] - 2), (long[line] - 1, long[line] - 1)]
            line = long[line]
        else:
            lines.append((line, line))
            line += 1
    return lines


def _label(row: Row, line: int, pixels: int) -> str:
    """Return the label of a field in the 8-byte group number `line`, or `""` if the group gets no label.

    The first group of a field has a label. If the label was truncated there, the second group repeats the label.
    """
    begins = row.offset // BYTES_PER_LINE
    head = min(row.size, BYTES_PER_LINE - row.offset % BYTES_PER_LINE)
    if line == begins:
        return _fit_label(row, pixels)
    cut = _fit_label(row, head * _CELL - 2).startswith(_ELLIPSIS)
    return f"{_ELLIPSIS} {_fit_label(row, pixels - 2 * _CHARACTER)}" if cut and line == begins + 1 else ""


def _fit_label(row: Row, pixels: int) -> str:
    """Return the longest label of a field that fits into `pixels`: path and type, path, name, or the end of the name.

    The end is kept, because names of neighbouring fields often differ only at the end.
    """
    capacity = (pixels - 10) // _CHARACTER
    name = row.path.rpartition(".")[2]
    for text in (f"{row.path} : {row.ros}", row.path, name):
        if len(text) <= capacity:
            return text
    return _ELLIPSIS + name[-(capacity - 1) :]
