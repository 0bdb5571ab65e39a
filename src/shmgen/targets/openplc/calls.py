"""Generate the client and server blocks of services and actions: C that calls templates/c/shmgen_block_calls.h."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layout, Layouts, TypeName
from shmgen.targets import interfaces
from shmgen.targets.c.names import struct_name
from shmgen.targets.counts import holds_counts
from shmgen.targets.openplc.blocks import Block, Blocks, copies, enter
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.st import names as st


class Call(NamedTuple):
    """A service or an action, with the layouts of the messages in its regions.

    The client sends `question` to the server; the server sends `progress` and `answer` to the client. A service has no
    progress messages, so its `progress` is None.
    """

    name: TypeName
    layouts: Layouts
    compiler: Compiler
    question: Layout
    answer: Layout
    progress: Layout | None = None

    @property
    def needs(self) -> tuple[TypeName, ...]:
        return tuple(layout.name for layout in (self.question, self.answer, self.progress) if layout)

    @property
    def parts(self) -> tuple[str, str]:
        """The parts of the question and of the answer that the program exchanges with the block."""
        return ("Goal", "Result") if self.progress else ("Request", "Response")

    def copies(self, layout: Layout, at: str, part: str, *, to_plc: bool) -> Iterator[str]:
        """Yield the C statements that copy a part of a message to a variable of the block, or from it.

        `at` is the C expression for the message, whose layout is `layout`. `part` is a name such as `Goal`: the block
        has the variable `GOAL`, and the message has the field `goal`. The part `Request` is a message of its own.
        """
        struct = f"{'const ' if to_plc else ''}{struct_name(layout.name)}"
        yield f"        {struct} *message = ({struct} *){at};"
        inner, field = self.layouts[self.name.part(f"_{part}")], "" if part == "Request" else f"{part.lower()}."
        variable = self.compiler.structure(part.upper())
        for line in copies(inner, self.layouts, self.compiler, variable, f"message->{field}", to_plc=to_plc):
            yield f"        {line}"


def blocks(layouts: Layouts, compiler: Compiler, known: Blocks) -> Iterator[Block]:
    """Yield the client block and the server block of each requested service and action.

    `known` supplies the inputs and outputs of the blocks, from the blocks of the target st.
    """
    for name in interfaces.complete(layouts):
        endings = interfaces.REGIONS[name.kind].values()
        call = Call(name, layouts, compiler, *(layouts[name.part(ending)] for ending in endings))
        action = "Action" if call.progress else ""
        yield known.block(st.block_name(name, f"{action}Client"), _calls(call), call.needs)
        yield known.block(st.block_name(name, f"{action}Server"), _serves(call), call.needs)


def _constant(layout: Layout, name: str) -> int:
    return next(int(str(one.value)) for one in layout.message.constants if one.name == name)


def _open_lines(call: Call, calls: str) -> Iterator[str]:
    yield "shmgen_interface carries;"
    yield "memset(&carries, 0, sizeof carries);"
    for member, layout in (("request", call.question), ("response", call.answer), ("progress", call.progress)):
        if layout:
            name = struct_name(layout.name)
            parts = f"shmgen_type_of_{name}(), shmgen_check_{name}, shmgen_receive_{name}"
            yield f"carries.{member} = shmgen_part_of({parts});"
    yield f"end = shmgen_call_open(&number, {call.compiler.owner}, &carries, {calls}, {{text}}, {{length}});"


def _calls(call: Call) -> Iterator[str]:
    get, put, compiler = call.compiler.get, call.compiler.put, call.compiler
    question, answer = call.parts
    yield from enter(compiler, "SACTION" if call.progress else "SSERVICE", _open_lines(call, "true"))
    if call.progress:
        yield "bool fresh = false;"
    yield "if (end != NULL) {"
    yield f"    shmgen_block_client_cycle(end, {get('XEXECUTE')} != 0, {get('XCANCEL')} != 0);"
    yield "    if (shmgen_block_client_sends(end)) {"
    yield from call.copies(call.question, "end->message", question, to_plc=False)
    if call.progress:
        yield "        message->cancel = 0;"
    yield "        shmgen_block_client_send(end);"
    yield "    }"
    if call.progress:
        yield "    fresh = shmgen_block_client_hears(end);"
        yield "    if (fresh) {"
        yield from call.copies(call.progress, "end->call->progress", "Feedback", to_plc=True)
        yield "    }"
    yield f"    if (shmgen_block_client_ends(end, {compiler.ns('TTIMEOUT')})) {{"
    yield from call.copies(call.answer, "end->call->response", answer, to_plc=True)
    yield "    }"
    if call.progress:
        yield f"    {put('SISTATUS', 'end->call->how')}"
        if holds_counts(call.progress, call.layouts):
            yield f"    {put('UDIREFUSED', 'end->refused')}"
    yield "}"
    for variable, member in (("XDONE", "done"), ("XBUSY", "busy"), ("XABORTED", "aborted")):
        yield put(variable, f"end != NULL && end->call->{member}")
    if call.progress:
        yield put("XNEWFEEDBACK", "fresh")
    yield from _ends(call, "shmgen_block_client_error(end, enabled)", "shmgen_block_client_has_failed(end, enabled)")


def _serves(call: Call) -> Iterator[str]:
    get, put, compiler = call.compiler.get, call.compiler.put, call.compiler
    question, answer = call.parts
    says = {"XDONE": "SUCCEEDED", "XABORTED": "CANCELED", "XFAILED": "ABORTED", "XREJECT": "REJECTED"}
    if not call.progress:
        says = {"XDONE": "DONE", "XFAILED": "FAILED"}
    numbers = {variable: _constant(call.answer, name) for variable, name in says.items()}
    job = "".join(f"{get(variable)} != 0 ? {number} : " for variable, number in reversed(numbers.items()))
    good, bad = numbers["XDONE"], numbers["XFAILED"]
    yield from enter(compiler, "SACTION" if call.progress else "SSERVICE", _open_lines(call, "false"))
    yield "if (end != NULL) {"
    yield f"    shmgen_block_server_cycle(end, {job}0);"
    yield "    if (shmgen_block_server_responds(end)) {"
    yield from call.copies(call.answer, "end->call->response", answer, to_plc=False)
    yield f"        shmgen_block_server_respond(end, {good}, {bad});"
    yield "    }"
    if call.progress:
        yield f"    if ({get('XSEND')} != 0 && shmgen_block_server_reports(end)) {{"
        yield from call.copies(call.progress, "end->call->progress", "Feedback", to_plc=False)
        yield "        shmgen_block_server_report(end);"
        yield "    }"
    yield f"    if (shmgen_block_server_takes(end, {numbers['XREJECT' if call.progress else 'XFAILED']})) {{"
    yield from call.copies(call.question, "end->message", question, to_plc=True)
    yield "    }"
    if holds_counts(call.question, call.layouts):
        yield f"    {put('UDIREFUSED', 'end->refused')}"
    yield "}"
    yield put("XEXECUTE", "end != NULL && end->call->execute")
    if call.progress:
        yield put("XCANCEL", "end != NULL && end->call->cancel")
    yield put("XBUSY", "shmgen_block_server_is_busy(end)")
    yield from _ends(call, "shmgen_block_server_error(end, enabled)", "shmgen_block_server_error(end, enabled) != 0")


def _ends(call: Call, error: str, failed: str) -> Iterator[str]:
    put = call.compiler.put
    yield put("EERRORID", error)
    yield put("XERROR", failed)
    yield put("UDIGOAL" if call.progress else "UDICALL", "end != NULL ? end->call->number : 0")
    yield "shmgen_block_leave(end);"
