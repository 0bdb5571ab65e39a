"""Generate the parts of the C header with a message's publisher and subscriber, and the protocol's headers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from shmgen.core.model import Layout, Layouts, Output, Ref, Regions, Role, Slot, String
from shmgen.targets.c.names import c_member, ends_header, header, struct_name
from shmgen.targets.c.text import Head, head, quoted
from shmgen.targets.counts import bound, counts

_ENDS = "status link access lock wake open publisher subscriber borrow calls client server runtime notifier"
RUNTIME = (*_ENDS.split(), "block", "block_calls")
"""Handwritten headers in templates/c. Each needs the headers before it. The last two serve function blocks in C."""


class RegionSettings(NamedTuple):
    """The settings in `[regions]` of shmgen.toml as C expressions.

    `mode` is an octal number, or `0` if the mode is not set. `group` is a string, or `NULL` if the group is not set.
    `sequence` is `1` for `sync = "sequence"`, which means regions without a lock, otherwise `0`.
    """

    mode: str
    group: str
    sequence: str


def region_settings(regions: Regions) -> RegionSettings:
    return RegionSettings(
        mode=f"0{regions.mode:o}" if regions.mode else "0",
        group=quoted(regions.group.encode()) if regions.group else "NULL",
        sequence="1" if regions.sync == "sequence" else "0",
    )


def runtime(folder: str) -> Iterator[Output]:
    """Yield the protocol's headers in `folder`, such as `c/shm_msgs`."""
    for name in RUNTIME:
        yield Output(f"{folder}/shmgen_{name}.h", f"c/shmgen_{name}.h", None)


def ends_head(layout: Layout, package: str) -> Head:
    """Return the start of the header with a message's publisher and subscriber."""
    name = layout.name
    includes = [f"{package}/shmgen_runtime.h", header(name, package)]
    includes += sorted(ends_header(inner, package) for inner in layout.dependencies)
    ends = f"{struct_name(name)}_publisher, {struct_name(name)}_subscriber"
    summary = f"The publisher and the subscriber of {name} in shared memory: {ends}."
    return head(summary, layout.message.origin, ends_header(name, package), includes)


def limits(layout: Layout, layouts: Layouts) -> bool:
    """Return True if the message has a sequence or a string, in its own fields or in nested messages."""
    return any(limited(slot, layouts) for slot in layout.slots)


def limited(slot: Slot, layouts: Layouts) -> bool:
    """Return True if a reader must check the field against a bound.

    Such a field is a sequence's count, a string, or a nested message with a sequence or a string.
    """
    if isinstance(slot.type, Ref):
        return limits(layouts[slot.type.name], layouts)
    return slot.role is Role.COUNT or isinstance(slot.type, String)


def check(layout: Layout, layouts: Layouts) -> Iterator[str]:
    """Yield the C statements that check a message before it is sent. `sent` is the message's pointer in C.

    The statements return an error for the first field that exceeds its bound.
    """
    if not limits(layout, layouts):
        yield from ("(void)sent;", "(void)path;")
        return
    struct = struct_name(layout.name)
    yield f"const {struct} *message = (const {struct} *)sent;"
    if any(isinstance(slot.type, Ref) and limited(slot, layouts) for slot in layout.slots):
        yield "shmgen_status status;"
    yield from _counts(layout)
    yield from _each(layout, layouts, _check_lines)


def _check_lines(slot: Slot, member: str, at: str) -> Iterator[str]:
    if isinstance(slot.type, String):
        ends = "shmgen_ends_wide" if slot.type.wide else "shmgen_ends"
        yield f"if (!{ends}({member}, {(slot.type.capacity or 0) + 1}))"
        yield f"    return {at}, SHMGEN_TEXT_TOO_LONG);"
    else:
        assert isinstance(slot.type, Ref)
        yield f"status = shmgen_check_{struct_name(slot.type.name)}(&{member}, path);"
        yield "if (status != SHMGEN_OK)"
        yield f"    return {at}, status);"


def receive(layout: Layout, layouts: Layouts) -> Iterator[str]:
    """Yield the C statements that check the counts in a received message and terminate its strings.

    `copy` is the message's pointer in C.
    """
    if not limits(layout, layouts):
        yield from ("(void)copy;", "(void)path;")
        return
    struct = struct_name(layout.name)
    yield f"{struct} *message = ({struct} *)copy;"
    yield from _counts(layout)
    yield from _each(layout, layouts, _receive_lines)
    yield "(void)path;"


def _receive_lines(slot: Slot, member: str, at: str) -> Iterator[str]:
    if isinstance(slot.type, String):
        yield f"{member}[{slot.type.capacity or 0}] = 0;"
    else:
        assert isinstance(slot.type, Ref)
        receive = f"shmgen_receive_{struct_name(slot.type.name)}(&{member}, path)"
        yield f"if ({receive} != SHMGEN_OK)"
        yield f"    return {at}, SHMGEN_COUNT_EXCEEDED);"


def _each(layout: Layout, layouts: Layouts, statements: Callable[[Slot, str, str], Iterator[str]]) -> Iterator[str]:
    """Yield C statements that handle each field with a sequence or a string, in a loop if the field has elements.

    The function `statements` returns the statements for one value. Its arguments are the field, the C expression for
    the value, and the beginning of the C call that records the path of the field for error messages.
    """
    counted = counts(layout)
    for slot in layout.slots:
        if slot.role is not Role.DATA or not limited(slot, layouts):
            continue
        member, path = f"message->{c_member(slot.name)}", quoted(slot.name.encode())
        if slot.count is None:
            yield from statements(slot, member, f"shmgen_at(path, {path}")
            continue
        last = f"message->{c_member(counted[slot.name].name)}" if slot.name in counted else str(slot.count)
        yield f"for (uint32_t element = 0; element < {last}; element++) {{"
        at = f"shmgen_at_element(path, {path}, element"
        yield from (f"    {one}" for one in statements(slot, f"{member}[element]", at))
        yield "}"


def _counts(layout: Layout) -> Iterator[str]:
    for name, count in counts(layout).items():
        yield f"if (message->{c_member(count.name)} > {bound(count)})"
        yield f"    return shmgen_at(path, {quoted(name.encode())}, SHMGEN_COUNT_EXCEEDED);"
