"""Turns Layouts into C headers, for C11 and C++17, that assert every offset and size at compile time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.diagnostics import Report
from shmgen.model import (
    Clock,
    Constant,
    Element,
    Layout,
    Layouts,
    Output,
    Ref,
    Role,
    Scalar,
    Slot,
    String,
    TypeOptions,
    assert_never,
    ros_type,
)
from shmgen.targets import Job
from shmgen.targets.c import region
from shmgen.targets.c.names import NAMES as NAMES
from shmgen.targets.c.names import c_member, header, macro, struct_name
from shmgen.targets.counts import bound, counts, holds_counts
from shmgen.wording import counted

_TYPES = {
    Scalar.BOOL: "uint8_t",
    Scalar.FLOAT32: "float",
    Scalar.FLOAT64: "double",
}
_CLOCKS = {"TIME": "uint32_t", "LTIME": "uint64_t", "struct": "shmgen_seconds"}
_CLOCK_UNITS = {"TIME": "ms", "LTIME": "ns", "struct": "s and ns"}


class Member(NamedTuple):
    """`double x[3];` with its offset, size and comment."""

    declaration: str
    name: str
    offset: str
    size: str
    comment: str


class Define(NamedTuple):
    name: str
    value: str
    comment: str


class Header(NamedTuple):
    """One message; all strings finished."""

    title: str
    origin: str
    guard: str
    includes: tuple[str, ...]
    doc: tuple[str, ...]
    struct: str
    size: str
    bytes: str
    digest: str
    defines: tuple[Define, ...]
    members: tuple[Member, ...]
    valid: tuple[str, ...]


def plan(job: Job, report: Report) -> Iterator[Output]:
    """`c/<package>/<ros package>/msg/pose.h` for each message, and `c/<package>/shmgen.h`."""
    yield region.plan(job.package)
    for name, layout in job.layouts.items():
        yield Output(f"c/{header(name, job.package)}", "c/message.h.j2", _header(layout, job.layouts, job.package))


def _header(layout: Layout, layouts: Layouts, package: str) -> Header:
    struct = struct_name(layout.name)
    return Header(
        title=str(layout.name),
        origin=_in_comment(layout.message.origin),
        guard=header(layout.name, package).upper().replace("/", "_").replace(".", "_"),
        includes=(f"{package}/shmgen.h", *sorted(header(name, package) for name in layout.dependencies)),
        doc=tuple(_in_comment(layout.message.doc).splitlines()),
        struct=struct,
        size=str(layout.size),
        bytes=counted(layout.size, "byte"),
        digest=f"{layout.digest:016x}",
        defines=tuple(
            Define(
                macro(layout.name, constant.name),
                _literal(constant, layout.options),
                _beside(constant.doc),
            )
            for constant in layout.message.constants
        ),
        members=tuple(_member(slot, layout) for slot in layout.slots),
        valid=tuple(_valid(layout, layouts)) or ("(void)message;",),
    )


def _member(slot: Slot, layout: Layout) -> Member:
    name = c_member(slot.name)
    many = "" if slot.count is None else f"[{slot.count}]"
    tail = f"[{(slot.type.capacity or 0) + 1}]" if isinstance(slot.type, String) else ""
    base = c_element(slot.type, layout.options)
    return Member(f"{base} {name}{many}{tail};", name, str(slot.offset), str(slot.size), _comment(slot, layout))


def _valid(layout: Layout, layouts: Layouts) -> Iterator[str]:
    """Statements that return 0 for a count above its bound, here or in an element that is valid."""
    counted = counts(layout)
    for count in counted.values():
        yield from (f"if (message->{c_member(count.name)} > {bound(count)})", "    return 0;")
    for slot in layout.slots:
        if not isinstance(slot.type, Ref) or not holds_counts(layouts[slot.type.name], layouts):
            continue
        member, check = f"message->{c_member(slot.name)}", f"shmgen_valid_{struct_name(slot.type.name)}"
        if slot.count is None:
            yield from (f"if (!{check}(&{member}))", "    return 0;")
        else:
            last = f"message->{c_member(counted[slot.name].name)}" if slot.name in counted else str(slot.count)
            yield f"for (uint32_t element = 0; element < {last}; element++)"
            yield from (f"    if (!{check}(&{member}[element]))", "        return 0;")


def c_element(type_: Element, options: TypeOptions) -> str:
    """The C type of one element; a string's is that of a character."""
    match type_:
        case Scalar():
            return _TYPES.get(type_, f"{type_.value}_t")
        case Clock():
            return _CLOCKS[options.time]
        case String(_, wide):
            return "uint16_t" if wide else "char"
        case Ref(name):
            return struct_name(name)
        case _:
            assert_never(type_)


def _comment(slot: Slot, layout: Layout) -> str:
    """Offset, what it is in ROS, unit, and its comment."""
    match slot.role:
        case Role.PADDING:
            return f"{slot.offset}"
        case Role.FILLER:
            return f"{slot.offset}: the message has no fields"
        case Role.COUNT:
            return f"{slot.offset}: how many of the next are valid"
        case Role.DATA:
            assert slot.field is not None
            unit = f" [{slot.field.unit}]" if slot.field.unit else ""
            if isinstance(slot.type, Clock) and not unit:
                unit = f" [{_CLOCK_UNITS[layout.options.time]}]"
            doc = slot.field.doc
            return _beside(f"{slot.offset}: {ros_type(slot.field.type)}{unit}" + (f", {doc}" if doc else ""))
        case _:
            assert_never(slot.role)


def _beside(text: str) -> str:
    """A comment behind a declaration; its second line and those below it stand under it."""
    first, *others = _in_comment(text).split("\n")
    return "\n".join([first, *(f"     * {line}".rstrip() for line in others)])


def _in_comment(text: str) -> str:
    """Text that can neither end the comment it stands in nor begin another; `??/` is a backslash to C11."""
    printable = "".join(char if char == "\n" or char.isprintable() else " " for char in text)
    return printable.replace("??/", "? ?/").replace("*/", "* /").replace("/*", "/ *").rstrip()


def _literal(constant: Constant, options: TypeOptions) -> str:
    value = constant.value
    match constant.type:
        case String(_, wide):
            return _quoted_wide(str(value)) if wide else _quoted(str(value).encode(options.encoding))
        case Scalar.FLOAT32 | Scalar.FLOAT64:
            number = float(value)
            text = {"inf": "1.0 / 0.0", "-inf": "-1.0 / 0.0", "nan": "0.0 / 0.0"}.get(repr(number), repr(number))
            return f"(({_TYPES[constant.type]})({text}))"
        case Scalar() as scalar:
            number = int(value)
            suffix = "ULL" if scalar is Scalar.UINT64 else "LL" if scalar.size > 4 or number < -(2**31) + 1 else ""
            text = f"{number}{suffix}" if number > -(2**63) else f"{number + 1}{suffix} - 1"
            return f"(({_TYPES.get(scalar, f'{scalar.value}_t')})({text}))"
        case _:
            assert_never(constant.type)


_PLAIN = set(range(0x20, 0x7F)) - set(b'"\\?')
"""`?` is none, against trigraphs."""


def _quoted(text: bytes) -> str:
    """A C string literal: all but plain ASCII as three octal digits."""
    return '"' + "".join(chr(byte) if byte in _PLAIN else f"\\{byte:03o}" for byte in text) + '"'


def _quoted_wide(text: str) -> str:
    """A char16_t literal. Octal below U+00A0, where the standards have no universal character names."""
    return 'u"' + "".join(_wide(ord(char)) for char in text) + '"'


def _wide(code: int) -> str:
    if code in _PLAIN:
        return chr(code)
    return f"\\{code:03o}" if code < 0xA0 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
