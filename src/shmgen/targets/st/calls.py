"""Generate the client and server blocks of services and actions, such as `FB_std_srvs_SetBool_Client`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layouts, Output, TypeName
from shmgen.targets import interfaces
from shmgen.targets.st import common, names
from shmgen.targets.st.counts import Check, checks


class Carried(NamedTuple):
    """The Structured Text names of one message in a region: its structure, and the list of its constants.

    `variable` is the block's variable that holds a sample. `suffix` ends the region's name, such as `-request`.
    """

    dut: str
    gvl: str
    variable: str
    suffix: str


class Calls(NamedTuple):
    """The template data for the client or server block of a service or an action.

    `end` is the variable with the block's FB_ShmClient or FB_ShmServer, and `input` the block's input with the name of
    the service or action. `copy` is the statement that copies a received message to the block's output. `refusal` is
    the status with which a server refuses a request, or `""` if the block refuses no request.
    `response`, `goal`, `feedback` and `result` are structure names, `""` if the service or action has no such message.
    If `fits` is true, the block checks counts in the requests or replies that it receives. If `fits_progress` is true,
    the client of an action also checks counts in the progress messages.
    """

    name: str
    title: str
    end: str
    input: str
    copy: str
    refusal: str
    request: Carried
    reply: Carried
    fits: bool
    checks: tuple[Check, ...]
    response: str = ""
    progress: Carried | None = None
    goal: str = ""
    feedback: str = ""
    result: str = ""
    fits_progress: bool = False


def plan(layouts: Layouts) -> Iterator[Output]:
    """Yield the files with the blocks of all services and actions. If there are none, yield nothing."""
    all_names = list(interfaces.complete(layouts))
    if all_names:
        yield from common.by_hand("FB_ShmClient", "FB_ShmServer")
    for name in all_names:
        yield from (_service if name.kind == "srv" else _action)(name, layouts)


def parts(layouts: Layouts) -> frozenset[TypeName]:
    """Return the names of all messages that the regions of services and actions contain."""
    whole = set(interfaces.complete(layouts))
    return frozenset(name for name in layouts if name._replace(name=name.name.rpartition("_")[0]) in whole)


def _service(name: TypeName, layouts: Layouts) -> Iterator[Output]:
    request = _carried(name.part("_Request"), layouts, "Request", "-request")
    reply = _carried(name.part("_Reply"), layouts, "_Reply", "-response")
    response = names.st_type(name.part("_Response"), layouts[name.part("_Response")].options)
    for role, read, copy, refusal in (
        ("Client", "_Reply", "Response := _Reply.response;", ""),
        ("Server", "_Request", "Request := _Request;", "FAILED"),
    ):
        block, own = names.block_name(name, role), checks(layouts[name.part(read)], layouts, "Fits", read)
        refusal = refusal if own else ""
        view = Calls(
            block, name.short, f"_fb{role}", "sService", copy, refusal, request, reply, bool(own), own, response
        )
        yield Output(f"st/{name.package}/{block}.st", f"st/{role.lower()}.st.j2", view)


def _action(name: TypeName, layouts: Layouts) -> Iterator[Output]:
    command, progress, outcome = (
        _carried(name.part(part), layouts, part, suffix)
        for part, suffix in (("_Command", "-goal"), ("_Progress", "-feedback"), ("_Outcome", "-result"))
    )
    goal, feedback, result = (
        names.st_type(name.part(part), layouts[name.part(part)].options) for part in ("_Goal", "_Feedback", "_Result")
    )
    for role, read, received, copy, refusal in (
        ("Client", "_Outcome", ("_Progress",), "Result := _Outcome.result;", ""),
        ("Server", "_Command", (), "Goal := _Command.goal;", "REJECTED"),
    ):
        block, own = names.block_name(name, f"Action{role}"), checks(layouts[name.part(read)], layouts, "Fits", read)
        also = tuple(it for part in received for it in checks(layouts[name.part(part)], layouts, "FeedbackFits", part))
        ends = (f"_fb{role}", "sAction", copy, refusal if own else "", command, outcome)
        parts = ("", progress, goal, feedback, result)
        view = Calls(block, name.short, *ends, bool(own), (*own, *also), *parts, bool(also))
        yield Output(f"st/{name.package}/{block}.st", f"st/action_{role.lower()}.st.j2", view)


def _carried(name: TypeName, layouts: Layouts, variable: str, suffix: str) -> Carried:
    return Carried(names.st_type(name, layouts[name].options), names.gvl(name), variable, suffix)
