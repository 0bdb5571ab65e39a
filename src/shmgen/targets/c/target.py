"""Generate C headers from layouts, for C11 and C++17. The headers assert every offset and size at compile time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import (
    Clock,
    Constant,
    Layout,
    Layouts,
    Output,
    Ref,
    Role,
    Slot,
    String,
    TypeName,
    assert_never,
    ros_type,
)
from shmgen.targets import Job
from shmgen.targets.c import calls, ends, region
from shmgen.targets.c.names import NAMES as NAMES
from shmgen.targets.c.names import c_member, ends_header, header, macro, struct_name
from shmgen.targets.c.text import Head, in_comment, literal, message_head
from shmgen.targets.c.text import element as c_element
from shmgen.targets.counts import bound, counts, holds_counts

_CLOCK_UNITS = {"TIME": "ms", "LTIME": "ns", "struct": "s and ns"}


class Member(NamedTuple):
    """A declaration such as `double x[3];`, with its offset and size in bytes and its comment."""

    declaration: str
    name: str
    offset: str
    size: str
    comment: str


class Header(NamedTuple):
    """The template data for a message's header and for the header of its publisher and subscriber, as finished C code.

    `valid`, `check` and `receive` contain the C statements that check the message: its counts, all that publishing
    requires, and a received message.
    """

    head: Head
    doc: tuple[str, ...]
    title: str
    struct: str
    size: str
    digest: str
    defines: tuple[str, ...]
    members: tuple[Member, ...]
    valid: tuple[str, ...]
    requested: bool
    settings: ends.RegionSettings
    check: tuple[str, ...]
    receive: tuple[str, ...]


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield `c/<package>/<ros package>/msg/pose.h` and `pose_shm.h` for each message, and all shared files."""
    yield region.plan(job.package)
    yield from ends.runtime(f"c/{job.package}")
    for file in ("shmgen_library.c", "shmgen_library.map"):
        yield Output(f"c/{job.package}/{file}", f"c/{file}", None)
    for name, layout in job.layouts.items():
        view = _header(layout, job)
        yield Output(f"c/{header(name, job.package)}", "c/message.h.j2", view)
        yield Output(piece(name), "c/piece.h.j2", view, piece=True)
        ends_view = view._replace(head=ends.ends_head(layout, job.package))
        yield Output(f"c/{ends_header(name, job.package)}", "c/ends.h.j2", ends_view)
    yield from calls.plan(job.layouts, job.package)


def piece(name: TypeName) -> str:
    """Return the path of a piece, which is not written to a file; other targets include it in their files.

    The piece contains a message's structure, asserted offsets, type name and digest, and the functions that check its
    counts and strings. The piece contains no text from the user's definitions.
    """
    return f"c/piece/{struct_name(name)}"


def _header(layout: Layout, job: Job) -> Header:
    layouts, package = job.layouts, job.package
    includes = [f"{package}/shmgen.h", *sorted(header(name, package) for name in layout.dependencies)]
    return Header(
        head=message_head(layout, header(layout.name, package), includes),
        doc=tuple(in_comment(layout.message.doc).splitlines()),
        title=str(layout.name),
        struct=struct_name(layout.name),
        size=str(layout.size),
        digest=f"{layout.digest:016x}",
        defines=tuple(_define(constant, layout) for constant in layout.message.constants),
        members=tuple(_member(slot, layout) for slot in layout.slots),
        valid=tuple(_valid(layout, layouts)) or ("(void)message;",),
        requested=layout.requested,
        settings=ends.region_settings(job.options.regions),
        check=tuple(ends.check(layout, layouts)),
        receive=tuple(ends.receive(layout, layouts)),
    )


def _define(constant: Constant, layout: Layout) -> str:
    """Return the definition of the macro for a constant, with the constant's comment."""
    comment = _beside(constant.doc)
    define = f"#define {macro(layout.name, constant.name)} {literal(constant, layout.options)}"
    return f"{define} /* {comment} */" if comment else define


def _member(slot: Slot, layout: Layout) -> Member:
    name = c_member(slot.name)
    many = "" if slot.count is None else f"[{slot.count}]"
    tail = f"[{(slot.type.capacity or 0) + 1}]" if isinstance(slot.type, String) else ""
    base = c_element(slot.type, layout.options)
    return Member(f"{base} {name}{many}{tail};", name, str(slot.offset), str(slot.size), _comment(slot, layout))


def _valid(layout: Layout, layouts: Layouts) -> Iterator[str]:
    """Yield the C statements that validate a message: they return 0 if any count exceeds its bound.

    The statements also check nested messages, and only those elements of a sequence that are in use.
    """
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


def _comment(slot: Slot, layout: Layout) -> str:
    """Return a member's comment: offset in bytes, ROS type, unit, and the field's comment."""
    match slot.role:
        case Role.PADDING:
            return f"{slot.offset}"
        case Role.FILLER:
            return f"{slot.offset}: the message has no fields"
        case Role.COUNT:
            return f"{slot.offset}: number of valid elements in the next member"
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
    """Return a comment to place beside a declaration. Further lines are indented below the first."""
    first, *others = in_comment(text).split("\n")
    return "\n".join([first, *(f"     * {line}".rstrip() for line in others)])
