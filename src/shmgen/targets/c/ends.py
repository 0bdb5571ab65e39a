"""Turns a layout into the header of its publisher and subscriber in C, and the protocol's headers that they need."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from shmgen.core.model import Layout, Layouts, Output, Ref, Regions, Role, Slot, String
from shmgen.targets.c.names import c_member, ends_header, header, struct_name
from shmgen.targets.c.text import in_comment, quoted
from shmgen.targets.counts import bound, counts

_ENDS = "status link access lock wake open publisher subscriber borrow wait_any calls client server runtime"
RUNTIME = (*_ENDS.split(), "block", "block_calls")
"""Written by hand, in templates/c; each needs those before it. The last two are for function blocks of a PLC in C."""


class Ends(NamedTuple):
    """One message; all strings finished. `check` and `receive` are statements."""

    title: str
    origin: str
    guard: str
    includes: tuple[str, ...]
    struct: str
    requested: bool
    mode: str
    group: str
    sequence: str
    check: tuple[str, ...]
    receive: tuple[str, ...]


def runtime(folder: str) -> Iterator[Output]:
    """The protocol, into `folder`: `c/shm_msgs`."""
    for name in RUNTIME:
        yield Output(f"{folder}/shmgen_{name}.h", f"c/shmgen_{name}.h", None)


def plan(layout: Layout, layouts: Layouts, package: str, regions: Regions) -> Output:
    """`c/<package>/<ros package>/msg/pose_shm.h`."""
    name = layout.name
    path = ends_header(name, package)
    held = [f"{package}/shmgen_runtime.h", header(name, package)]
    held += sorted(ends_header(inner, package) for inner in layout.dependencies)
    return Output(
        f"c/{path}",
        "c/ends.h.j2",
        Ends(
            title=str(name),
            origin=in_comment(layout.message.origin),
            guard=path.upper().replace("/", "_").replace(".", "_"),
            includes=tuple(held),
            struct=struct_name(name),
            requested=layout.requested,
            mode=mode(regions),
            group=group(regions),
            sequence=sequence(regions),
            check=tuple(_check(layout, layouts)) or ("(void)sent;", "(void)path;"),
            receive=tuple(_receive(layout, layouts)) or ("(void)copy;", "(void)path;"),
        ),
    )


def mode(regions: Regions) -> str:
    """Of `[regions]` in shmgen.toml, as a number of C; 0 = not said."""
    return f"0{regions.mode:o}" if regions.mode else "0"


def group(regions: Regions) -> str:
    """As an expression of C; NULL = not said."""
    return quoted(regions.group.encode()) if regions.group else "NULL"


def sequence(regions: Regions) -> str:
    """1: there is no lock."""
    return "1" if regions.sync == "sequence" else "0"


def limits(layout: Layout, layouts: Layouts) -> bool:
    """Whether the message holds anything that may not fit: a sequence or a text, here or further in."""
    return any(limited(slot, layouts) for slot in layout.slots)


def limited(slot: Slot, layouts: Layouts) -> bool:
    """The same of a slot."""
    if isinstance(slot.type, Ref):
        return limits(layouts[slot.type.name], layouts)
    return slot.role is Role.COUNT or isinstance(slot.type, String)


def _check(layout: Layout, layouts: Layouts) -> Iterator[str]:
    """Statements that return for the first field of the message at `sent` that does not fit."""
    if not limits(layout, layouts):
        return
    struct = struct_name(layout.name)
    yield f"const {struct} *message = (const {struct} *)sent;"
    if any(isinstance(slot.type, Ref) for slot, _, _ in _fields(layout, layouts)):
        yield "shmgen_status status;"
    yield from _counts(layout)
    yield from _each(layout, layouts, _checked)


def _checked(slot: Slot, member: str, at: str) -> Iterator[str]:
    if isinstance(slot.type, String):
        ends = "shmgen_ends_wide" if slot.type.wide else "shmgen_ends"
        yield f"if (!{ends}({member}, {(slot.type.capacity or 0) + 1}))"
        yield f"    return {at}, SHMGEN_TEXT_TOO_LONG);"
    else:
        assert isinstance(slot.type, Ref)
        yield f"status = shmgen_check_{struct_name(slot.type.name)}(&{member}, path);"
        yield "if (status != SHMGEN_OK)"
        yield f"    return {at}, status);"


def _receive(layout: Layout, layouts: Layouts) -> Iterator[str]:
    """Statements that return for a count above its bound in the message at `copy`, and end its texts."""
    if not limits(layout, layouts):
        return
    struct = struct_name(layout.name)
    yield f"{struct} *message = ({struct} *)copy;"
    yield from _counts(layout)
    yield from _each(layout, layouts, _received)
    yield "(void)path;"


def _received(slot: Slot, member: str, at: str) -> Iterator[str]:
    if isinstance(slot.type, String):
        yield f"{member}[{slot.type.capacity or 0}] = 0;"
    else:
        assert isinstance(slot.type, Ref)
        receive = f"shmgen_receive_{struct_name(slot.type.name)}(&{member}, path)"
        yield f"if ({receive} != SHMGEN_OK)"
        yield f"    return {at}, SHMGEN_COUNT_EXCEEDED);"


def _each(layout: Layout, layouts: Layouts, statements: Callable[[Slot, str, str], Iterator[str]]) -> Iterator[str]:
    """`statements` of each field that may not fit, in a loop where it has elements; they end a call that tells it."""
    for slot, path, last in _fields(layout, layouts):
        member = f"message->{c_member(slot.name)}"
        if last:
            yield f"for (uint32_t element = 0; element < {last}; element++) {{"
            at = f"shmgen_at_element(path, {path}, element"
            yield from (f"    {one}" for one in statements(slot, f"{member}[element]", at))
            yield "}"
        else:
            yield from statements(slot, member, f"shmgen_at(path, {path}")


def _counts(layout: Layout) -> Iterator[str]:
    for name, count in counts(layout).items():
        yield f"if (message->{c_member(count.name)} > {bound(count)})"
        yield f"    return shmgen_at(path, {quoted(name.encode())}, SHMGEN_COUNT_EXCEEDED);"


def _fields(layout: Layout, layouts: Layouts) -> Iterator[tuple[Slot, str, str]]:
    """What may not fit, its path as a literal, and the number of its elements, empty where it is one."""
    counted = counts(layout)
    for slot in layout.slots:
        if slot.role is not Role.DATA or not limited(slot, layouts):
            continue
        last = "" if slot.count is None else str(slot.count)
        if slot.name in counted:
            last = f"message->{c_member(counted[slot.name].name)}"
        yield slot, quoted(slot.name.encode()), last
