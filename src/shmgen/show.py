"""Turns one Layout into what a person or a program reads: an offset table, JSON; and types and messages into lists."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass

from shmgen.layout import CLOCK, region_size
from shmgen.model import Clock, Layout, Layouts, Message, Ref, Role, Scalar, Slot, TypeOptions, ros_type
from shmgen.pipeline import Entry
from shmgen.targets.c import c_element
from shmgen.targets.naming import iec_element, iec_type


@dataclass(frozen=True, slots=True)
class Row:
    """A slot at its place in the whole message; `depth` counts the messages around it."""

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
    """All slots in order, each nested message followed by its own; an array of messages by those of element 0."""
    return list(_rows(layout, layouts, 0, 0, ""))


def table(layout: Layout, layouts: Layouts) -> str:
    """Offset, size, ROS type, IEC type and name in columns, nested members indented."""
    all_rows = rows(layout, layouts)
    lines = [
        (str(row.offset), str(row.size), row.ros, row.iec, "  " * row.depth + row.path.rpartition(".")[2], _remark(row))
        for row in all_rows
    ]
    head = ("offset", "size", "ROS", "IEC 61131-3", "name", "")
    widths = [max(len(line[column]) for line in [head, *lines]) for column in range(5)]
    text = [
        f"{layout.name}: {layout.size:,} bytes, alignment {layout.align}, digest {layout.digest:016x}",
        f"from {layout.message.origin}; a region of depth 1 takes {region_size(layout.size):,} bytes",
        *_place(layout.message),
        "",
    ]
    for offset, size, ros, iec, name, remark in [head, *lines]:
        columns = (
            f"{offset:>{widths[0]}}  {size:>{widths[1]}}  {name:<{widths[4]}}  {ros:<{widths[2]}}  {iec:<{widths[3]}}"
        )
        text.append(f"{columns}  {remark}".rstrip())
    return "\n".join(text) + "\n"


def as_json(shown: Iterable[Layout], layouts: Layouts) -> str:
    """The same of one or more messages for machines, always a list; offsets and sizes in bytes."""
    data = [
        {
            "type": str(layout.name),
            "origin": layout.message.origin,
            "size": layout.size,
            "align": layout.align,
            "digest": f"{layout.digest:016x}",
            "region_size": region_size(layout.size),
            "slots": [asdict(row) for row in rows(layout, layouts)],
        }
        for layout in shown
    ]
    return json.dumps(data, indent=2) + "\n"


def type_table(options: TypeOptions) -> str:
    """ROS, IEC 61131-3, C, bytes."""
    lines = [("ROS", "IEC 61131-3", "C", "bytes")]
    for scalar in Scalar:
        also = {Scalar.UINT8: "uint8, char, byte", Scalar.INT8: "int8 (ROS 1: byte)"}.get(scalar, scalar.value)
        lines.append((also, iec_element(scalar, options), c_element(scalar, options), str(scalar.size)))
    for clock in Clock:
        size = CLOCK[options.time][0]
        lines.append((clock.value, iec_element(clock, options), c_element(clock, options), str(size)))
    lines += [
        ("string, string<=n", "STRING(n)", "char[n+1]", "n+1"),
        ("wstring, wstring<=n", "WSTRING(n)", "uint16_t[n+1]", "2(n+1)"),
        ("T[N]", "ARRAY[0..N-1] OF T", "T[N]", ""),
        ("T[<=N], T[] with a bound", "UDINT and ARRAY[0..N-1] OF T", "uint32_t and T[N]", ""),
        ("package/Type", "ST_package_Type", "shm_package_Type", ""),
    ]
    widths = [max(len(line[column]) for line in lines) for column in range(3)]
    return "".join(
        f"{ros:<{widths[0]}}  {iec:<{widths[1]}}  {c:<{widths[2]}}  {size}".rstrip() + "\n"
        for ros, iec, c, size in lines
    )


def inventory(entries: list[Entry], machine: bool) -> str:
    """What can be generated, and what each other message still needs; `machine` gives JSON."""
    if machine:
        data = [
            {
                "type": str(entry.name),
                "size": entry.size,
                "unbounded": entry.unbounded,
                "faults": [{"code": fault.code, "message": fault.message} for fault in entry.faults],
            }
            for entry in entries
        ]
        return json.dumps(data, indent=2) + "\n"
    width = max((len(entry.name.short) for entry in entries), default=0)
    lines = [f"{entry.name.short:<{width}}  {_standing(entry)}" for entry in entries]
    ready = sum(entry.size is not None and not entry.faults for entry in entries)
    lines += ["", f"{ready} of {len(entries)} can be generated."]
    stopped = [key for entry in entries for key in entry.unbounded]
    if stopped:
        lines.append(f'Lines under [bounds] in shmgen.toml are wanted, such as "{stopped[0]}" = 8')
    codes = sorted({fault.code for entry in entries for fault in entry.faults})
    if codes:
        lines.append("More is said by " + " and ".join(f"`shmgen explain {code}`" for code in codes))
    return "\n".join(lines) + "\n"


_KEYS_SHOWN = 3


def _standing(entry: Entry) -> str:
    if entry.faults:
        return "; ".join(f"{fault.code} {fault.field}: {fault.message}" for fault in entry.faults)
    if entry.size is not None:
        return f"{entry.size:>9,} bytes"
    more = f" and {len(entry.unbounded) - _KEYS_SHOWN} more" if len(entry.unbounded) > _KEYS_SHOWN else ""
    return "needs a bound for " + ", ".join(entry.unbounded[:_KEYS_SHOWN]) + more


def _place(message: Message) -> list[str]:
    """Where a definition from outside the project lies on this machine; its origin does not say."""
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


def _remark(row: Row) -> str:
    unit = f"[{row.unit}] " if row.unit else ""
    first = row.doc.partition("\n")[0]
    return unit + (first if len(first) <= 60 else first[:59] + "…")
