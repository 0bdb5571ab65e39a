"""Convert the entries of a layout to the table of fields and the type annotations of a generated class.

docs/layout.md describes the table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from typing import NamedTuple

from shmgen.core.model import Clock, Layout, Ref, Role, Scalar, Slot, String, TypeName, TypeOptions, assert_never
from shmgen.targets.python.names import python_member

_CLOCK_UNITS = {"TIME": "ms", "LTIME": "ns", "struct": "s+ns"}


class Line(NamedTuple):
    """A line of a generated class: `name: type = value`. `type` or `value` is `""` if the line omits this part."""

    name: str
    type: str = ""
    value: str = ""


def rows(layout: Layout, names: Mapping[TypeName, str]) -> Iterator[str]:
    """Yield the Python text of one table row for each field: name, kind, offset and size in bytes.

    The row of an array also contains the length of the array. The row of a sequence ends with the offset of its count.
    """
    count_at = None
    for slot in layout.slots:
        if slot.role is Role.COUNT:
            count_at = slot.offset
        elif slot.role is Role.DATA:
            numbers = [slot.offset, slot.element_size]
            numbers += [] if slot.count is None else [slot.count]
            numbers += [] if count_at is None else [count_at]
            name, kind = python_member(slot.name), _kind(slot, layout.options, names)
            yield f'("{name}", {kind}, {", ".join(map(str, numbers))})'
            count_at = None


def _kind(slot: Slot, options: TypeOptions, names: Mapping[TypeName, str]) -> str:
    """Return the element kind of a field as Python text: a string literal, or the class of a message."""
    match slot.type:
        case Scalar():
            return f'"{slot.type.value}"'
        case Clock():
            return f'"{slot.type.value} {_CLOCK_UNITS[options.time]}"'
        case String(_, wide):
            truncated = " truncated" if options.overflow == "truncate" else ""
            return f'"{"utf-16" if wide else options.encoding}{truncated}"'
        case Ref(name):
            return names[name]
        case _:
            assert_never(slot.type)


def annotation(slot: Slot, names: Mapping[TypeName, str]) -> str:
    match slot.type:
        case _ if slot.count is not None:
            return "typing.Any"
        case Scalar():
            return "bool" if slot.type is Scalar.BOOL else "float" if slot.type.is_float else "int"
        case Ref(name):
            return names[name]
        case String():
            return "str"
        case Clock():
            return "typing.Any"
        case _:
            assert_never(slot.type)


def hiding(annotations: list[Line], constants: list[Line], used: Set[str]) -> Iterator[str]:
    """Yield the lines of a class body that must come last, because they hide a name in `used`.

    * `used` are the names that the class body itself uses, such as `int`. After a line `int: float`, the name `int`
      would no longer mean the builtin type.
    * One assignment sets all constants with such names, because a value may use a name that another constant hides.
    * Fields named like a builtin type come after all others, whose annotations may use the builtin type.
    """
    hidden = [row for row in constants if row.name in used]
    if hidden:
        yield f"{', '.join(row.name for row in hidden)} = {', '.join(row.value for row in hidden)}"
    annotated = [row for row in annotations if row.name in used]
    last = ("bool", "float", "int", "str", "typing")
    yield from (f"{row.name}: {row.type}" for row in sorted(annotated, key=lambda row: row.name in last))
