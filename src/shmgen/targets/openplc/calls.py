"""Turns services and actions into function blocks: clients and servers, whose bodies are those of call_bodies.

Inputs, outputs and their meaning are those of the target st, but for eErrorID, which is a number here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from shmgen.core.model import Layout, Layouts
from shmgen.targets import interfaces
from shmgen.targets.counts import holds_counts
from shmgen.targets.openplc.blocks import END, Block, Variable, message, named
from shmgen.targets.openplc.call_bodies import Call, calls, serves
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.openplc.names import whole
from shmgen.targets.st import names as st


def blocks(layouts: Layouts, compiler: Compiler) -> Iterator[Block]:
    """Client and server of each service and action that was asked for."""
    for name in interfaces.services(layouts):
        request, reply = (layouts[name.part(part)] for part in ("_Request", "_Reply"))
        service = Call(name, layouts, compiler, request, reply, None)
        yield _client(service)
        yield _server(service)
    for name in interfaces.actions(layouts):
        command, outcome, progress = (layouts[name.part(part)] for part in ("_Command", "_Outcome", "_Progress"))
        action = Call(name, layouts, compiler, command, outcome, progress)
        yield _action_client(action)
        yield _action_server(action)


_ENABLE = Variable("xEnable", "BOOL", "TRUE: opens the regions, makes them if need be, and keeps them")


def _bool(name: str, comment: str, value: str = "") -> Variable:
    return Variable(name, "BOOL", comment, value)


def _asking(call: Call, named_input: Variable, what: str, cancel: str, timeout: tuple[str, str]) -> Iterator[Variable]:
    yield _ENABLE
    yield named_input
    yield _bool("xExecute", f"rising edge: sends {what}")
    yield _bool("xCancel", cancel)
    yield Variable(
        "tTimeout", "TIME", f"CALL_TIMEOUT (50) after so long without {timeout[0]}; T#0s = never", timeout[1]
    )
    yield message(what, call.part(f"_{what}"), "")


def _serving(refused: Layout, what: str, how: str, call: Call) -> Iterator[Variable]:
    yield _bool("xBusy", "the regions are being opened")
    yield _bool("xError", "see eErrorID; opening is tried again")
    yield Variable("eErrorID", "UDINT", "0, or why")
    yield message(what, call.part(f"_{what}"), "")
    yield Variable(f"udi{'Goal' if call.progress else 'Call'}", "UDINT", f"number of that in {what}")
    if holds_counts(refused, call.layouts):
        yield Variable("udiRefused", "UDINT", f"those with a count above its bound, answered {how}: 52 until the next")


def _block(
    call: Call, name: str, doc: str, inputs: Iterable[Variable], outputs: Iterable[Variable], body: Iterable[str]
) -> Block:
    needs = [layout.name for layout in (call.question, call.answer, call.progress) if layout]
    return Block(
        whole(name),
        f"{doc} Call it once in each cycle.",
        tuple(inputs),
        tuple(outputs),
        (END,),
        tuple(body),
        tuple(needs),
    )


def _client(call: Call) -> Block:
    service = named(call.compiler, "sService", "/cell/start")
    cancel = "TRUE: waits no longer; the server may do it all the same"
    outputs = (
        _bool("xDone", "the server has done it; Response is its answer"),
        _bool("xBusy", "the call goes on"),
        _bool("xAborted", "it was ended by xCancel"),
        _bool("xError", "it failed, see eErrorID"),
        Variable("eErrorID", "UDINT", "0, or why; while no call goes on: why the regions are not open"),
        message("Response", call.part("_Response"), ""),
        Variable("udiCall", "UDINT", "number of the call, 0 = not sent yet"),
    )
    inputs = _asking(call, service, "Request", cancel, ("an answer", "T#1s"))
    return _block(call, st.client_block(call.name), f"Calls a service {call.name.short}.", inputs, outputs, calls(call))


def _server(call: Call) -> Block:
    inputs = (
        _ENABLE,
        named(call.compiler, "sService", "/cell/start"),
        _bool("xDone", "TRUE: the job is done, Response is the answer. Must fall before the next call is taken,"),
        _bool("xFailed", "as this one: TRUE: the job cannot be done"),
        message("Response", call.part("_Response"), ""),
    )
    outputs = (
        _bool("xExecute", "a call waits for its answer; FALSE for a cycle at least between two calls"),
        *_serving(call.question, "Request", "FAILED", call),
    )
    doc = f"Serves {call.name.short} on one service."
    return _block(call, st.server_block(call.name), doc, inputs, outputs, serves(call))


def _action_client(call: Call) -> Block:
    assert call.progress
    action = named(call.compiler, "sAction", "/arm/move")
    cancel = "TRUE: asks the server to cancel the goal, which ends when the server says so"
    refused = Variable("udiRefused", "UDINT", "feedback with a count above its bound, which Feedback did not take")
    outputs = (
        _bool("xDone", "the goal was reached; Result is the answer"),
        _bool("xBusy", "the goal goes on"),
        _bool("xAborted", "it was cancelled"),
        _bool("xError", "it failed, see eErrorID and siStatus"),
        Variable("eErrorID", "UDINT", "0, or why; while no goal goes on: why the regions are not open"),
        message("Feedback", call.part("_Feedback"), ""),
        message("Result", call.part("_Result"), ""),
        _bool("xNewFeedback", "Feedback changed in this cycle"),
        Variable("siStatus", "SINT", "as in action_msgs/GoalStatus; 0 = nothing heard yet, -1 = rejected"),
        Variable("udiGoal", "UDINT", "number of the goal, 0 = not sent yet"),
        *([refused] if holds_counts(call.progress, call.layouts) else []),
    )
    doc = f"Sends goals to an action {call.name.short}."
    inputs = _asking(call, action, "Goal", cancel, ("a word about the goal", "T#10s"))
    return _block(call, st.action_client_block(call.name), doc, inputs, outputs, calls(call))


def _action_server(call: Call) -> Block:
    inputs = (
        _ENABLE,
        named(call.compiler, "sAction", "/arm/move"),
        _bool("xDone", "TRUE: the goal is reached. Must fall before the next goal is taken, as these:"),
        _bool("xAborted", "TRUE: the job ended because of xCancel"),
        _bool("xFailed", "TRUE: the job ended otherwise"),
        _bool("xReject", "TRUE: the goal is not accepted"),
        message("Result", call.part("_Result"), ""),
        _bool("xSend", "TRUE: publishes Feedback in this cycle", "TRUE"),
        message("Feedback", call.part("_Feedback"), ""),
    )
    outputs = (
        _bool("xExecute", "a goal is to be reached; FALSE for a cycle at least between two goals"),
        _bool("xCancel", "the client wants it no more: end the job"),
        *_serving(call.question, "Goal", "REJECTED", call),
    )
    doc = f"Serves goals of {call.name.short} on one action."
    return _block(call, st.action_server_block(call.name), doc, inputs, outputs, serves(call))
