"""Generate a message's publisher and subscriber block for an open compiler, STruC++ or matiec.

The blocks have the variables of the target st, and a body in C that calls templates/c/shmgen_block.h.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from shmgen.core.model import Layout, Layouts, Ref, Role, TypeName
from shmgen.targets import Job
from shmgen.targets.c.names import c_member, struct_name
from shmgen.targets.counts import counts, holds_counts
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.openplc.names import member, whole
from shmgen.targets.st import names as st
from shmgen.targets.st import objects, reader
from shmgen.targets.st.text import uncommented


class Variable(NamedTuple):
    """A variable of a block. `value` is its initial value in Structured Text, or `""`."""

    name: str
    type: str
    comment: str
    value: str = ""


class Block(NamedTuple):
    """A function block to generate. `needs` are the messages whose types and C structures the block uses."""

    name: str
    doc: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    body: tuple[str, ...]
    needs: tuple[TypeName, ...]


_ERROR = "E_ShmError"


class Blocks:
    """Creates the blocks for an open compiler from the blocks that the target st has rendered.

    The new blocks have the same inputs, outputs and comments. Types and names are spelled for the open compiler.
    """

    def __init__(self, job: Job, compiler: Compiler) -> None:
        self._units = {}
        for file in job.rendered["st"]:
            name = file.output.path.rpartition("/")[2].removesuffix(".st")
            if name == _ERROR:
                errors = reader.read(name, file.text)
                assert isinstance(errors, objects.DataType)
                self._codes = {it.name: it.value for it in errors.members}
            elif name.startswith("FB_"):
                self._units[name] = file.text
        own = {st.st_type(it.name, it.options): whole(st.st_type(it.name)) for it in job.layouts.values()}
        self._types = {**own, _ERROR: "UDINT", "STRING(80)": compiler.text(80, False)}

    def block(self, name: str, body: Iterable[str], needs: tuple[TypeName, ...]) -> Block:
        unit = reader.read(name, self._units[name])
        assert isinstance(unit, objects.Unit)
        inputs, outputs = (tuple(map(self._convert, section.variables)) for section in unit.sections[:2])
        return Block(whole(name), uncommented(unit.head.comment[:1]), inputs, outputs, tuple(body), needs)

    def _convert(self, variable: objects.Variable) -> Variable:
        comment = re.sub(r"[A-Z_]{4,}", self._with_code, uncommented(variable.comment))
        return Variable(variable.name, self._types.get(variable.type, variable.type), comment, str(variable.value))

    def _with_code(self, word: re.Match[str]) -> str:
        """Return the name of an error with its number, such as `NO_ERROR (0)`. Return any other word unchanged.

        The open compilers have no enumerations, so a program compares the number.
        """
        return f"{word[0]} ({self._codes[word[0]]})" if word[0] in self._codes else word[0]


def pair(layout: Layout, layouts: Layouts, compiler: Compiler, known: Blocks) -> tuple[Block, Block]:
    name = layout.name
    return (
        known.block(st.block_name(name, "Publisher"), _publish(layout, layouts, compiler), (name,)),
        known.block(st.block_name(name, "Subscriber"), _read(layout, layouts, compiler), (name,)),
    )


def enter(compiler: Compiler, name: str, opened: Iterable[str]) -> Iterator[str]:
    """Yield the C statements at the start of a block's body: find the block's open endpoint, or open a new one.

    The endpoint is a publisher, subscriber, client or server. It is opened on the rising edge of `xEnable`, by the C
    lines in `opened`. `name` is the block's input with the topic. In `opened`, `{text}` and `{length}` stand for the
    text and the length of this input.
    """
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
    name = struct_name(layout.name)
    yield from _enter(layout, compiler, "true")
    yield "bool sent = false;"
    yield "if (end != NULL) {"
    yield "    const bool is_open = shmgen_block_is_open(end);"  # called once: the call may open the region
    yield f"    const bool send = is_open && {compiler.get('XSEND')} != 0;"
    yield "    shmgen_status fits = SHMGEN_OK;"
    yield "    if (send) {"
    yield f"        {name} *message = ({name} *)end->message;"
    for line in copies(layout, layouts, compiler, compiler.structure("MSG"), "message->", to_plc=False):
        yield f"        {line}"
    yield "        shmgen_path_clear(&end->publisher.path);"
    yield f"        fits = shmgen_check_{name}(message, &end->publisher.path);"
    yield "    }"
    yield "    sent = is_open && shmgen_block_write(end, send, fits);"
    yield f"    {compiler.put('UDISEQUENCE', 'end->sequence')}"
    yield f"    {compiler.put('UDILOCKMISSES', 'shmgen_block_misses(end)')}"
    yield "}"
    yield compiler.put("XSENT", "sent")
    yield from _leave(compiler)


def copies(
    layout: Layout, layouts: Layouts, compiler: Compiler, plc: str, c: str, *, to_plc: bool, depth: int = 0
) -> Iterator[str]:
    """Yield the C statements that copy a message between the C structure `c` and the program's variable `plc`.

    The compilers do not store a structure with the layout of the region, so each field is copied separately. Only the
    valid elements of a sequence are copied. If `to_plc` is true, the statements copy from `c` to `plc`, otherwise from
    `plc` to `c`. `depth` is the number of messages around this message.
    """
    counted = counts(layout)
    leaf = compiler.leaf_in if to_plc else compiler.leaf_out
    index = f"i{depth}"
    for slot in layout.slots:
        if slot.role is Role.PADDING:
            continue
        variable, field = f"{plc}.{member(slot.name).upper()}", f"{c}{c_member(slot.name)}"
        if slot.count is not None:
            variable, field = compiler.element(variable, index), f"{field}[{index}]"
        if isinstance(slot.type, Ref):
            inner = layouts[slot.type.name]
            lines = copies(inner, layouts, compiler, variable, f"{field}.", to_plc=to_plc, depth=depth + 1)
        else:
            lines = iter([leaf(variable, field, slot.type, layout.options)])
        if slot.count is None:
            yield from lines
        else:
            # The program's count is not yet checked.
            used = f" && {index} < {c}{c_member(counted[slot.name].name)}" if slot.name in counted else ""
            yield f"for (uint32_t {index} = 0; {index} < {slot.count}{used}; {index}++) {{"
            yield from (f"    {line}" for line in lines)
            yield "}"


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
