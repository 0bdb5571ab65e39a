"""Turns a service or an action into the bodies of its blocks: C that calls templates/c/shmgen_block_calls.h."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layout, Layouts, TypeName
from shmgen.targets.c.names import struct_name
from shmgen.targets.counts import holds_counts
from shmgen.targets.openplc.blocks import enter, fill
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.openplc.copying import copies


class Call(NamedTuple):
    """A service, or an action, which has a `progress`."""

    name: TypeName
    layouts: Layouts
    compiler: Compiler
    question: Layout
    answer: Layout
    progress: Layout | None

    @property
    def number(self) -> str:
        """What an answer calls the number of its call."""
        return "goal" if self.progress else "call"

    def part(self, ending: str) -> Layout:
        return self.layouts[self.name.part(ending)]

    def copied(self, layout: Layout, variable: str, at: str) -> list[str]:
        """From `message` to the program."""
        return copies(layout, self.layouts, self.compiler, self.compiler.structure(variable), at, to_plc=True)


def _constant(layout: Layout, name: str) -> int:
    return next(int(str(one.value)) for one in layout.message.constants if one.name == name)


def _opened(call: Call, calls: str) -> Iterator[str]:
    types = [f"{struct_name(one.name)}_type()" for one in (call.question, call.answer, call.progress) if one]
    yield f"const shmgen_type types[] = {{{{{', '.join(types)}}}}};"
    yield (
        f"end = shmgen_call_open(&number, {call.compiler.owner}, types, {len(types)}, {calls}, {{text}}, {{length}});"
    )


def _look(layout: Layout, end: str) -> Iterator[str]:
    """What was read, and whether its counts are within their bounds."""
    name = struct_name(layout.name)
    yield f"{name} *message = ({name} *){end}->message;"
    yield f"fits = shmgen_receive_{name}(message, &{end}->subscriber.path);"


def calls(call: Call) -> Iterator[str]:
    get, put, compiler = call.compiler.get, call.compiler.put, call.compiler
    yield from enter(compiler, "SACTION" if call.progress else "SSERVICE", _opened(call, "true"))
    if call.progress:
        yield "bool fresh = false;"
    yield "if (end != NULL) {"
    yield "    shmgen_status fits = SHMGEN_OK;"
    yield f"    shmgen_caller_cycle(end, {get('XEXECUTE')} != 0, {get('XCANCEL')} != 0);"
    yield "    if (shmgen_caller_asks(end)) {"
    yield from (f"        {line}" for line in _ask(call))
    yield "        shmgen_caller_ask(end, fits);"
    yield "    }"
    if call.progress:
        yield from (f"    {line}" for line in _follow(call, call.progress))
    yield f"    if (shmgen_caller_is_answered(end, {compiler.ns('TTIMEOUT')})) {{"
    yield from (f"        {line}" for line in _look(call.answer, "end->beside[0]"))
    good = _constant(call.answer, "SUCCEEDED" if call.progress else "DONE")
    canceled = _constant(call.answer, "CANCELED") if call.progress else good
    how = f"message->{call.number}, message->status, {good}, {canceled}"
    yield f"        if (shmgen_caller_take(end, {how}, fits)) {{"
    taken = call.copied(call.part("_Result"), "RESULT", "message->result.") if call.progress else _response(call)
    yield from (f"            {line}" for line in taken)
    yield "        }"
    yield "    }"
    if call.progress:
        yield f"    {put('SISTATUS', 'end->call.how')}"
        if holds_counts(call.progress, call.layouts):
            yield f"    {put('UDIREFUSED', 'end->refused')}"
    yield "}"
    for variable, member in (("XDONE", "done"), ("XBUSY", "busy"), ("XABORTED", "aborted")):
        yield put(variable, f"end != NULL && end->call.{member}")
    if call.progress:
        yield put("XNEWFEEDBACK", "fresh")
    yield from _ends(call, "shmgen_caller_error(end, enabled)", "shmgen_caller_has_failed(end, enabled)")


def _response(call: Call) -> list[str]:
    return call.copied(call.part("_Response"), "RESPONSE", "message->response.")


def _ask(call: Call) -> Iterator[str]:
    """The wish to cancel a goal carries none."""
    if not call.progress:
        yield from fill(call.question, call.layouts, call.compiler, "end", (("REQUEST", "", call.question.name),))
        return
    name = struct_name(call.question.name)
    yield f"{name} *command = ({name} *)end->message;"
    yield "memset(command, 0, sizeof *command);"
    yield "if (end->call.number == 0) {"
    goal = (("GOAL", "goal.", call.part("_Goal").name),)
    yield from (f"    {line}" for line in fill(call.question, call.layouts, call.compiler, "end", goal))
    yield "}"
    yield "command->cancel = end->call.number;"


def _follow(call: Call, progress: Layout) -> Iterator[str]:
    yield "if (shmgen_caller_hears(end)) {"
    yield from (f"    {line}" for line in _look(progress, "end->beside[1]"))
    accepted = _constant(progress, "ACCEPTED")
    yield f"    if (shmgen_caller_heard(end, message->goal, message->status) && message->status != {accepted}) {{"
    yield "        fresh = fits == SHMGEN_OK;"
    yield "        end->refused += fresh ? 0 : 1;"
    yield "    }"
    yield "    if (fresh) {"
    feedback = call.copied(call.part("_Feedback"), "FEEDBACK", "message->feedback.")
    yield from (f"        {line}" for line in feedback)
    yield "    }"
    yield "}"


def serves(call: Call) -> Iterator[str]:
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
    yield "    shmgen_status fits = SHMGEN_OK;"
    yield f"    shmgen_server_cycle(end, {job}0);"
    yield "    if (shmgen_server_answers(end)) {"
    answer = ((what[0], what[1], call.part(what[2]).name),)
    yield from (f"        {line}" for line in fill(call.answer, call.layouts, compiler, "end->beside[0]", answer))
    yield "        if (fits != SHMGEN_OK)"
    yield "            memset(message, 0, sizeof *message);"
    yield f"        message->{call.number} = end->call.answered;"
    yield f"        message->status = shmgen_server_how(end, fits, {good}, {bad});"
    yield "        shmgen_server_answer(end);"
    yield "    }"
    if call.progress:
        yield from (f"    {line}" for line in _report(call, call.progress))
    yield "    if (shmgen_server_is_asked(end)) {"
    yield from (f"        {line}" for line in _look(call.question, "end"))
    refusal = numbers["XREJECT" if call.progress else "XFAILED"]
    canceled = "message->cancel" if call.progress else "0"
    yield f"        if (shmgen_server_take(end, {canceled}, fits, {refusal})) {{"
    asked = ("_Goal", "GOAL", "message->goal.") if call.progress else ("_Request", "REQUEST", "message->")
    yield from (f"            {line}" for line in call.copied(call.part(asked[0]), *asked[1:]))
    yield "        }"
    yield "    }"
    if holds_counts(call.question, call.layouts):
        yield f"    {put('UDIREFUSED', 'end->refused')}"
    yield "}"
    yield put("XEXECUTE", "end != NULL && end->call.execute")
    if call.progress:
        yield put("XCANCEL", "end != NULL && end->call.cancel")
    yield put("XBUSY", "shmgen_server_is_busy(end)")
    yield from _ends(call, "shmgen_server_error(end, enabled)", "shmgen_server_error(end, enabled) != 0")


def _report(call: Call, progress: Layout) -> Iterator[str]:
    yield f"if ({call.compiler.get('XSEND')} != 0 && shmgen_server_reports(end)) {{"
    feedback = (("FEEDBACK", "feedback.", call.part("_Feedback").name),)
    yield from (f"    {line}" for line in fill(progress, call.layouts, call.compiler, "end->beside[1]", feedback))
    yield "    message->goal = end->call.number;"
    canceling, executing = (_constant(progress, name) for name in ("CANCELING", "EXECUTING"))
    yield f"    message->status = end->call.cancel ? {canceling} : {executing};"
    yield "    shmgen_block_write(end->beside[1], true, fits);"
    yield "}"


def _ends(call: Call, error: str, failed: str) -> Iterator[str]:
    put = call.compiler.put
    yield put("EERRORID", error)
    yield put("XERROR", failed)
    yield put("UDIGOAL" if call.progress else "UDICALL", "end != NULL ? end->call.number : 0")
    yield "shmgen_block_leave(end);"
