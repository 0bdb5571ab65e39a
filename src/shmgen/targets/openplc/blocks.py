"""Turns a Layout into its pair of function blocks: variables, and a body in C that calls templates/c/shmgen_block.h.

Inputs, outputs and their meaning are those of the target st, but for eErrorID, which is a number here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from shmgen.core.model import Layout, Layouts, TypeName
from shmgen.targets.c.names import struct_name
from shmgen.targets.counts import holds_counts
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.openplc.copying import copies
from shmgen.targets.openplc.names import whole
from shmgen.targets.st import names as st


class Variable(NamedTuple):
    """`value` is what it begins with, in Structured Text, or nothing."""

    name: str
    type: str
    comment: str
    value: str = ""


class Block(NamedTuple):
    """A function block; `needs` are the messages whose types and C structures it uses."""

    name: str
    doc: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    locals: tuple[Variable, ...]
    body: tuple[str, ...]
    needs: tuple[TypeName, ...]


END = Variable("_udiEnd", "UDINT", "the open end's number; not to be written")
_ENABLE = Variable("xEnable", "BOOL", "TRUE: opens the region, makes it if need be, and keeps it")
_DEPTH = Variable(
    "udiDepth", "UDINT", "samples a slow reader can still fetch, as on the other side; read as sTopic", "1"
)
_STATE = (
    Variable("xBusy", "BOOL", "the region is being opened"),
    Variable("xError", "BOOL", "see eErrorID; opening is tried again"),
    Variable("eErrorID", "UDINT", "0, or why"),
)


def pair(layout: Layout, layouts: Layouts, compiler: Compiler) -> tuple[Block, Block]:
    return _publisher(layout, layouts, compiler), _subscriber(layout, layouts, compiler)


def named(compiler: Compiler, name: str, example: str) -> Variable:
    """The input with the name of what the block opens."""
    return Variable(name, compiler.text(80, False), f"'{example}'; read on the rising edge of xEnable")


def message(name: str, layout: Layout, comment: str) -> Variable:
    """An input or output that is a structure."""
    return Variable(name, whole(st.st_type(layout.name)), comment)


def _publisher(layout: Layout, layouts: Layouts, compiler: Compiler) -> Block:
    misses = "cycles in which the lock was not free"
    return Block(
        whole(st.publisher_block(layout.name)),
        f"Publishes {layout.name} on one topic. Call it once in each cycle.",
        (
            _ENABLE,
            named(compiler, "sTopic", "/robot/pose"),
            Variable("xSend", "BOOL", "TRUE: writes Msg in this cycle", "TRUE"),
            message("Msg", layout, ""),
            _DEPTH,
        ),
        (
            Variable("xSent", "BOOL", "Msg was written in this cycle"),
            *_STATE,
            Variable("udiSequence", "UDINT", "number of the sample written last"),
            Variable("udiLockMisses", "UDINT", misses),
        ),
        (END,),
        tuple(_publish(layout, layouts, compiler)),
        (layout.name,),
    )


def _subscriber(layout: Layout, layouts: Layouts, compiler: Compiler) -> Block:
    refused = (
        [Variable("udiRefused", "UDINT", "samples with a count above its bound, which Msg did not take")]
        if holds_counts(layout, layouts)
        else []
    )
    return Block(
        whole(st.subscriber_block(layout.name)),
        f"Reads {layout.name} from one topic. Call it once in each cycle.",
        (
            _ENABLE,
            named(compiler, "sTopic", "/robot/pose"),
            Variable("tTimeout", "TIME", "xStale after so long without a sign of the writer", "T#1s"),
            Variable("xNewest", "BOOL", "FALSE: the oldest unread sample, one a call", "TRUE"),
            _DEPTH,
        ),
        (
            Variable("xValid", "BOOL", "Msg holds a sample received since the rising edge of xEnable"),
            Variable("xNewData", "BOOL", "Msg changed in this cycle"),
            *_STATE,
            message("Msg", layout, ""),
            Variable("udiSequence", "UDINT", "number of the sample in Msg"),
            Variable("udiMissed", "UDINT", "samples overwritten unread"),
            Variable("udiLockMisses", "UDINT", "cycles in which the lock was not free"),
            Variable("xStale", "BOOL", "the writer's heartbeat has not changed for tTimeout"),
            *refused,
        ),
        (END,),
        tuple(_read(layout, layouts, compiler)),
        (layout.name,),
    )


def enter(compiler: Compiler, name: str, opened: Iterable[str]) -> Iterator[str]:
    """Finds the block's end, or opens it on the rising edge: `opened` takes the text and length of the input `name`."""
    statement, text, length = compiler.topic(name)
    yield f"const bool enabled = {compiler.get('XENABLE')} != 0;"
    yield f"uint32_t number = {compiler.get('_UDIEND')};"
    yield f"shmgen_block *end = shmgen_block_enter(&number, {compiler.owner}, enabled);"
    yield "if (end == NULL && enabled) {"
    if statement:
        yield f"    {statement}"
    yield from (f"    {line.format(text=text, length=length)}" for line in opened)
    yield "}"
    yield compiler.put("_UDIEND", "number")


def _enter(layout: Layout, compiler: Compiler, writer: str) -> Iterator[str]:
    depth = compiler.get("UDIDEPTH")
    opened = (
        f"const shmgen_type type = shmgen_type_of_{struct_name(layout.name)}();",
        f"end = shmgen_block_open(&number, {compiler.owner}, &type, {writer}, {{text}}, {{length}}, {depth});",
    )
    yield from enter(compiler, "STOPIC", opened)


def _leave(compiler: Compiler) -> Iterator[str]:
    yield compiler.put("EERRORID", "shmgen_block_error(end, enabled)")
    yield compiler.put("XERROR", "shmgen_block_error(end, enabled) != 0")
    yield compiler.put("XBUSY", "shmgen_block_is_busy(end)")
    yield "shmgen_block_leave(end);"


def _publish(layout: Layout, layouts: Layouts, compiler: Compiler) -> Iterator[str]:
    yield from _enter(layout, compiler, "true")
    yield "bool sent = false;"
    yield "if (end != NULL) {"
    yield "    const bool is_open = shmgen_block_is_open(end);"  # asked once: a call may be the one that opens
    yield f"    const bool send = is_open && {compiler.get('XSEND')} != 0;"
    yield "    shmgen_status fits = SHMGEN_OK;"
    yield "    if (send) {"
    yield from (f"        {line}" for line in fill(layout, layouts, compiler, "end->message", ("MSG", "", layout.name)))
    yield "        shmgen_path_clear(&end->publisher.path);"
    yield f"        fits = shmgen_check_{struct_name(layout.name)}(message, &end->publisher.path);"
    yield "    }"
    yield "    sent = is_open && shmgen_block_write(end, send, fits);"
    yield f"    {compiler.put('UDISEQUENCE', 'end->sequence')}"
    yield f"    {compiler.put('UDILOCKMISSES', 'shmgen_block_misses(end)')}"
    yield "}"
    yield compiler.put("XSENT", "sent")
    yield from _leave(compiler)


def fill(
    layout: Layout, layouts: Layouts, compiler: Compiler, at: str, part: tuple[str, str, TypeName]
) -> Iterator[str]:
    """Copies an input into the message at `at`, to the member that it is."""
    name = struct_name(layout.name)
    yield f"{name} *message = ({name} *){at};"
    variable, member, held = part
    place = compiler.structure(variable)
    yield from copies(layouts[held], layouts, compiler, place, f"message->{member}", to_plc=False)


def _read(layout: Layout, layouts: Layouts, compiler: Compiler) -> Iterator[str]:
    name = struct_name(layout.name)
    yield from _enter(layout, compiler, "false")
    yield "bool fresh = false;"
    yield "if (end != NULL) {"
    newest = f"{compiler.get('XNEWEST')} != 0"
    yield f"    fresh = shmgen_block_read(end, {newest}, shmgen_receive_{name});"
    yield "    if (fresh) {"
    yield f"        const {name} *message = (const {name} *)end->message;"
    for line in copies(layout, layouts, compiler, compiler.structure("MSG"), "message->", to_plc=True):
        yield f"        {line}"
    yield "    }"
    yield f"    {compiler.put('UDISEQUENCE', 'end->sequence')}"
    yield f"    {compiler.put('UDIMISSED', 'shmgen_block_missed(end)')}"
    yield f"    {compiler.put('UDILOCKMISSES', 'shmgen_block_misses(end)')}"
    if holds_counts(layout, layouts):
        yield f"    {compiler.put('UDIREFUSED', 'shmgen_block_refused(end)')}"
    yield "}"
    yield compiler.put("XNEWDATA", "fresh")
    yield compiler.put("XVALID", "shmgen_block_is_valid(end, fresh)")
    yield compiler.put("XSTALE", f"shmgen_block_is_stale(end, {compiler.ns('TTIMEOUT')})")
    yield from _leave(compiler)
