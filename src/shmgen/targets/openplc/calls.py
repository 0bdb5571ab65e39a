"""Generate the client and server blocks of services and actions: C that calls templates/c/shmgen_block_calls.h."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layout, Layouts, TypeName
from shmgen.targets import interfaces
from shmgen.targets.c.names import struct_name
from shmgen.targets.counts import holds_counts
from shmgen.targets.openplc.blocks import Block, Blocks, copies, enter, fill
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

    def part(self, ending: str) -> Layout:
        return self.layouts[self.name.part(ending)]

    @property
    def needs(self) -> tuple[TypeName, ...]:
        return tuple(layout.name for layout in (self.question, self.answer, self.progress) if layout)

    def copied(self, layout: Layout, variable: str, at: str) -> Iterator[str]:
        """Yield the C statements that copy the message at the C expression `at` to a variable of the block."""
        return copies(layout, self.layouts, self.compiler, self.compiler.structure(variable), at, to_plc=True)


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


def _opened(call: Call, calls: str) -> Iterator[str]:
    yield "shmgen_interface carries;"
    yield "memset(&carries, 0, sizeof carries);"
    for member, layout in (("request", call.question), ("response", call.answer), ("progress", call.progress)):
        if layout:
            name = struct_name(layout.name)
            parts = f"shmgen_type_of_{name}(), shmgen_check_{name}, shmgen_receive_{name}"
            yield f"carries.{member} = shmgen_part_of({parts});"
    yield f"end = shmgen_call_open(&number, {call.compiler.owner}, &carries, {calls}, {{text}}, {{length}});"


def _message_pointer(layout: Layout, at: str) -> str:
    name = struct_name(layout.name)
    return f"const {name} *message = (const {name} *){at};"


def _calls(call: Call) -> Iterator[str]:
    get, put, compiler = call.compiler.get, call.compiler.put, call.compiler
    yield from enter(compiler, "SACTION" if call.progress else "SSERVICE", _opened(call, "true"))
    if call.progress:
        yield "bool fresh = false;"
    yield "if (end != NULL) {"
    yield f"    shmgen_block_client_cycle(end, {get('XEXECUTE')} != 0, {get('XCANCEL')} != 0);"
    yield "    if (shmgen_block_client_sends(end)) {"
    sent = ("GOAL", "goal.", call.part("_Goal").name) if call.progress else ("REQUEST", "", call.question.name)
    yield from (f"        {line}" for line in fill(call.question, call.layouts, compiler, "end->message", sent))
    if call.progress:
        yield "        message->cancel = 0;"
    yield "        shmgen_block_client_send(end);"
    yield "    }"
    if call.progress:
        yield "    fresh = shmgen_block_client_hears(end);"
        yield "    if (fresh) {"
        yield f"        {_message_pointer(call.progress, 'end->call->progress')}"
        feedback = call.copied(call.part("_Feedback"), "FEEDBACK", "message->feedback.")
        yield from (f"        {line}" for line in feedback)
        yield "    }"
    yield f"    if (shmgen_block_client_ends(end, {compiler.ns('TTIMEOUT')})) {{"
    yield f"        {_message_pointer(call.answer, 'end->call->response')}"
    what = ("_Result", "RESULT", "result") if call.progress else ("_Response", "RESPONSE", "response")
    copied_lines = call.copied(call.part(what[0]), what[1], f"message->{what[2]}.")
    yield from (f"        {line}" for line in copied_lines)
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
    says = {"XDONE": "SUCCEEDED", "XABORTED": "CANCELED", "XFAILED": "ABORTED", "XREJECT": "REJECTED"}
    if not call.progress:
        says = {"XDONE": "DONE", "XFAILED": "FAILED"}
    numbers = {variable: _constant(call.answer, name) for variable, name in says.items()}
    job = "".join(f"{get(variable)} != 0 ? {number} : " for variable, number in reversed(numbers.items()))
    good, bad = numbers["XDONE"], numbers["XFAILED"]
    what = ("RESULT", "result.", "_Result") if call.progress else ("RESPONSE", "response.", "_Response")
    yield from enter(compiler, "SACTION" if call.progress else "SSERVICE", _opened(call, "false"))
    yield "if (end != NULL) {"
    yield f"    shmgen_block_server_cycle(end, {job}0);"
    yield "    if (shmgen_block_server_responds(end)) {"
    answer = what[0], what[1], call.part(what[2]).name
    yield from (f"        {line}" for line in fill(call.answer, call.layouts, compiler, "end->call->response", answer))
    yield f"        shmgen_block_server_respond(end, {good}, {bad});"
    yield "    }"
    if call.progress:
        yield f"    if ({get('XSEND')} != 0 && shmgen_block_server_reports(end)) {{"
        feedback = "FEEDBACK", "feedback.", call.part("_Feedback").name
        filled = fill(call.progress, call.layouts, compiler, "end->call->progress", feedback)
        yield from (f"        {line}" for line in filled)
        yield "        shmgen_block_server_report(end);"
        yield "    }"
    yield f"    if (shmgen_block_server_takes(end, {numbers['XREJECT' if call.progress else 'XFAILED']})) {{"
    yield f"        {_message_pointer(call.question, 'end->message')}"
    request_part = ("_Goal", "GOAL", "message->goal.") if call.progress else ("_Request", "REQUEST", "message->")
    yield from (f"        {line}" for line in call.copied(call.part(request_part[0]), *request_part[1:]))
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
