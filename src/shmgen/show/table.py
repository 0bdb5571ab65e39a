"""Show a Layout as a table of offsets or as JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass

from shmgen.core.abi import region_size
from shmgen.core.model import Layout, Layouts, Message, Ref, Role, Slot, TypeName, ros_type
from shmgen.core.plural import counted
from shmgen.core.type_hash import hash_of, hashes
from shmgen.targets.st.names import iec_type


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table: a field, count or padding, with its offset from the start of the whole message.

    `path` also contains the names of the outer fields, such as `position.x`. `depth` is the number of outer fields.
    `role` is the value of a Role, and `ros` and `iec` are the types. `nested` is True if the type is a message.
    """

    offset: int
    size: int
    path: str
    depth: int
    role: str
    ros: str
    iec: str
    unit: str
    doc: str
    nested: bool


def rows(layout: Layout, layouts: Layouts) -> list[Row]:
    """Return a row for each field, count and padding of a message, in order of the offsets.

    A nested message is followed by the rows of its fields, and an array of messages by the rows of its element 0.
    """
    return list(_rows(layout, layouts, 0, 0, ""))


def leaves(layout: Layout, layouts: Layouts) -> list[Row]:
    """Return the rows of a message, with the fields of a nested message instead of its row. An array is one row."""
    return [row for row in rows(layout, layouts) if "[0]." not in row.path and (not row.nested or "[" in row.ros)]


def table(layout: Layout, layouts: Layouts) -> str:
    """Return a table of offset, size, name, ROS type and IEC type. Fields of nested messages are indented."""
    lines = [("offset", "size", "name", "ROS", "IEC 61131-3", "")]
    for row in rows(layout, layouts):
        name = "  " * row.depth + row.path.rpartition(".")[2]
        lines.append((str(row.offset), str(row.size), name, row.ros, row.iec, _comment(row)))
    text = [
        f"{layout.name}: {counted(layout.size, 'byte')}, alignment {layout.align}, digest {layout.digest:016x}",
        f"from {layout.message.origin}; a region of depth 1 takes {region_size(layout.size):,} bytes",
        f"in ROS 2 {hash_of(layout.name, _known(layouts))}",
        *_place(layout.message),
        "",
        *aligned(lines, numbers=2),
    ]
    return "\n".join(text) + "\n"


def aligned(lines: Sequence[Sequence[str]], numbers: int = 0) -> Iterator[str]:
    """Yield lines of aligned columns, the first `numbers` columns aligned on the right and the others on the left."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        right = [cell.rjust(width) for cell, width in zip(line[:numbers], widths[:numbers], strict=True)]
        left = [cell.ljust(width) for cell, width in zip(line[numbers:], widths[numbers:], strict=True)]
        yield "  ".join([*right, *left]).rstrip()


def as_json(layouts_shown: Iterable[Layout], layouts: Layouts) -> str:
    """Return the layouts of one or more messages as a JSON list; offsets and sizes are in bytes."""
    type_hashes = hashes(layouts, _known(layouts))
    data = [
        {
            "type": str(layout.name),
            "origin": layout.message.origin,
            "size": layout.size,
            "align": layout.align,
            "digest": f"{layout.digest:016x}",
            "type_hash": type_hashes[layout.name],
            "region_size": region_size(layout.size),
            "slots": [asdict(row) for row in rows(layout, layouts)],
        }
        for layout in layouts_shown
    ]
    return json.dumps(data, indent=2) + "\n"


def _known(layouts: Layouts) -> dict[TypeName, Message]:
    return {name: layout.message for name, layout in layouts.items()}


def _place(message: Message) -> list[str]:
    """Return the line `read from PATH` if the definition is outside the project, otherwise no line.

    table() prints this line below `from ORIGIN`, because ORIGIN does not contain the path of such a definition.
    """
    return [f"read from {message.span.path}"] if os.path.isabs(message.span.path) else []


def _rows(layout: Layout, layouts: Layouts, base: int, depth: int, prefix: str) -> Iterator[Row]:
    for slot in layout.slots:
        path = prefix + slot.name
        offset = base + slot.offset
        yield Row(
            offset,
            slot.size,
            path,
            depth,
            slot.role.value,
            _ros(slot),
            iec_type(slot, layout.options),
            slot.field.unit if slot.field and slot.role is Role.DATA else "",
            slot.field.doc if slot.field and slot.role is Role.DATA else "",
            isinstance(slot.type, Ref),
        )
        if isinstance(slot.type, Ref):
            inner = f"{path}." if slot.count is None else f"{path}[0]."
            yield from _rows(layouts[slot.type.name], layouts, offset, depth + 1, inner)


def _ros(slot: Slot) -> str:
    match slot.role:
        case Role.PADDING | Role.FILLER:
            return ""
        case Role.COUNT:
            return "(count)"
        case Role.DATA:
            assert slot.field is not None
            return ros_type(slot.field.type)


def _comment(row: Row) -> str:
    unit = f"[{row.unit}] " if row.unit else ""
    first = row.doc.partition("\n")[0]
    return unit + (first if len(first) <= 60 else first[:59] + "…")
