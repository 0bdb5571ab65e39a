"""Turns bounded messages into Layouts. Only this module decides offsets, sizes and padding.

Fields have natural alignment, and every gap is an explicit slot. Therefore a packed structure has the same bytes on
every machine and with every compiler (docs/layout.md).
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping

from shmgen.core import abi
from shmgen.core.diagnostics import Report
from shmgen.core.model import (
    Array,
    Clock,
    Constant,
    Element,
    Field,
    Layout,
    Layouts,
    Message,
    Ref,
    Role,
    Scalar,
    Schema,
    Sequence,
    Slot,
    String,
    TypeName,
    TypeOptions,
    assert_never,
    element_of,
    text_bytes,
    text_length,
)
from shmgen.core.plural import counted
from shmgen.core.type_hash import FILLER

DEEPEST = 50
"""Maximum depth of nested messages. The deepest message of ROS has 7 levels."""

CLOCK = {"TIME": (4, 4), "LTIME": (8, 8), "struct": (8, 4)}
"""Value of `[types] time` -> size and alignment in bytes: ms as TIME, ns as LTIME, or seconds and nanoseconds."""


def lay_out(schema: Schema, options: TypeOptions, max_region: int, report: Report) -> Layouts:
    """Return the layouts of all messages, dependencies first.

    Raises Rejected for these errors:

    * SHM303: the smallest region of a requested message exceeds `max_region` bytes.
    * SHM304: messages nest too deeply.
    * SHM202: a type name is too long.
    * SHM005: a default or a constant does not fit its bound or the encoding.
    """
    layouts: dict[TypeName, Layout] = {}
    depths: dict[TypeName, int] = {}
    for message in schema.messages:
        layout = _message(message, options, layouts, message.name in schema.requested)
        layouts[message.name] = layout
        _check_values(message, options, report)
        if len(str(message.name)) > abi.MAX_TYPE_NAME:
            reason = f"{message.name} has more than {abi.MAX_TYPE_NAME} bytes, the limit of a type name"
            report.error("SHM202", reason, message.span, hint="shorten the name of the package or message")
        depths[message.name] = 1 + max((depths[name] for name in layout.dependencies), default=0)
        if depths[message.name] == DEEPEST + 1:
            hint = "move the innermost fields to an outer message"
            reason = f"{message.name.short} nests messages more than {DEEPEST} deep"
            report.error("SHM304", reason, message.span, hint=hint)
        if layout.requested:
            check_size(layout, max_region, report)
    report.stop_if_any()
    return layouts


def check_size(layout: Layout, max_region: int, report: Report) -> None:
    """Report SHM303 if the smallest region of the message has more than `max_region` bytes."""
    size = abi.region_size(layout.size)
    if size > max_region:
        largest = max(layout.slots, key=lambda slot: slot.size)
        report.error(
            "SHM303",
            f"{layout.name.short} needs a region of {size:,} bytes, more than {max_region:,}",
            largest.field.span if largest.field else layout.message.span,
            field=f"{layout.name.short}.{largest.name} ({counted(largest.size, 'byte')})",
            hint="lower a bound under [bounds] or [strings], or raise max_region in shmgen.toml",
        )


def canonical_text(layout: Layout, layouts: Mapping[TypeName, Layout]) -> str:
    """Return the text that the digest is computed from: everything that gives the bytes their meaning."""
    lines = [f"shmgen layout 1 {layout.name} size {layout.size} align {layout.align}"]
    for slot in layout.slots:
        if slot.role is not Role.PADDING:
            count = "" if slot.count is None else f"[{slot.count}]"
            meaning = _meaning(slot.type, layout.options, layouts)
            lines.append(f"{slot.offset} {slot.size} {slot.role.value} {slot.name} {meaning}{count}")
    return "\n".join(lines) + "\n"


def _message(message: Message, options: TypeOptions, layouts: Mapping[TypeName, Layout], requested: bool) -> Layout:
    slots: list[Slot] = []
    paddings = itertools.count()
    offset = 0
    widest = 1
    for name, type_, count, role, field in _members(message):
        size, align = _extent(type_, options, layouts)
        packed = min(align, message.pack)
        offset = _pad(slots, paddings, offset, max(packed, field.align if field else 1))
        slot = Slot(name, type_, count, offset, size * (count or 1), align, role, field)
        slots.append(slot)
        offset += slot.size
        widest = max(widest, packed)
    size = _pad(slots, paddings, offset, widest)
    draft = Layout(message, tuple(slots), size, widest, 0, options, requested)
    digest = hashlib.sha256(canonical_text(draft, layouts).encode()).digest()[:8]
    return draft._replace(digest=int.from_bytes(digest, "big"))


def _check_values(message: Message, options: TypeOptions, report: Report) -> None:
    """Report SHM005 for defaults and constants that exceed a bound or do not fit the configured encoding."""
    declarations: tuple[Field | Constant, ...] = (*message.fields, *message.constants)
    for declared in declarations:
        value = declared.default if isinstance(declared, Field) else declared.value
        path = f"{message.name.short}.{declared.name}"
        values = value if isinstance(value, tuple) else (value,)
        capacity = declared.type.capacity if isinstance(declared.type, Sequence) else None
        if capacity is not None and isinstance(value, tuple) and len(value) > capacity:
            fault = f"the default has {counted(len(value), 'element')}, but the bound is {capacity}"
            hint = f'set "{path}" = {len(value)} under [bounds] in shmgen.toml'
            report.error("SHM005", fault, declared.span, field=path, hint=hint)
        element = element_of(declared.type)
        for text in values:
            if isinstance(text, str) and isinstance(element, String):
                fault, hint = _misfit(text, element, options, path)
                if fault:
                    report.error("SHM005", fault, declared.span, field=path, hint=hint)


def _misfit(text: str, string: String, options: TypeOptions, path: str) -> tuple[str, str]:
    """Return the reason why a text does not fit into a string, and a hint. Return two empty texts if the text fits."""
    try:
        length = text_length(text, string, options.encoding)
    except UnicodeEncodeError as error:
        return (
            f"{text!r:.60} cannot be written in {error.encoding}",
            'set encoding = "utf-8" under [strings] in shmgen.toml',
        )
    if string.capacity is not None and length > string.capacity:
        return f"{text!r:.60} is longer than its bound", f'set "{path}" = {length} under [strings] in shmgen.toml'
    return "", ""


_Member = tuple[str, Element, int | None, Role, Field | None]


def _members(message: Message) -> Iterator[_Member]:
    for field in message.fields:
        match field.type:
            case Array(element, length):
                yield field.name, element, length, Role.DATA, field
            case Sequence(element, capacity):
                assert capacity is not None, "bounds come before layout"
                yield f"{field.name}_count", Scalar.UINT32, None, Role.COUNT, field
                yield field.name, element, capacity, Role.DATA, field
            case element:
                yield field.name, element, None, Role.DATA, field
    if not message.fields:
        yield FILLER, Scalar.UINT8, None, Role.FILLER, None


def _extent(type_: Element, options: TypeOptions, layouts: Mapping[TypeName, Layout]) -> tuple[int, int]:
    match type_:
        case Scalar():
            return type_.size, type_.size
        case Clock():
            return CLOCK[options.time]
        case String():
            return text_bytes(type_), 2 if type_.wide else 1
        case Ref(name):
            return layouts[name].size, layouts[name].align
        case _:
            assert_never(type_)


def _meaning(type_: Element, options: TypeOptions, layouts: Mapping[TypeName, Layout]) -> str:
    match type_:
        case Scalar.BOOL:
            return options.bool
        case Scalar():
            return type_.iec
        case Clock():
            return f"{options.time} {type_.value}"
        case String(capacity, wide):
            return f"WSTRING({capacity}) utf-16" if wide else f"STRING({capacity}) {options.encoding}"
        case Ref(name):
            return f"{name} {layouts[name].digest:016x}"
        case _:
            assert_never(type_)


def _pad(slots: list[Slot], numbers: Iterator[int], offset: int, align: int) -> int:
    gap = -offset % align
    if gap:
        slots.append(Slot(f"_pad{next(numbers)}", Scalar.UINT8, gap, offset, gap, 1, Role.PADDING))
    return offset + gap
