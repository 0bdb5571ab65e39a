"""Turns services and actions into C headers with their client and server, thin over those written by hand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layouts, Output, TypeName
from shmgen.targets import interfaces
from shmgen.targets.c.names import calls_header, calls_name, ends_header, struct_name
from shmgen.targets.c.text import in_comment


class Part(NamedTuple):
    """A member of shmgen_interface, and the structure of what it carries."""

    member: str
    struct: str


class Calls(NamedTuple):
    """`headed` are those of `parts` that begin with the `number` of a request; `progress` is empty for a service."""

    title: str
    origin: str
    guard: str
    includes: tuple[str, ...]
    name: str
    parts: tuple[Part, ...]
    headed: tuple[Part, ...]
    number: str
    request: str
    response: str
    progress: str
    ends: tuple[str, ...] = ("client", "server")


def plan(layouts: Layouts, package: str) -> Iterator[Output]:
    """`c/<package>/std_srvs/srv/set_bool_service.h` and `…/action/…_action.h`: no message's file ends so."""
    for service in interfaces.services(layouts):
        yield _output(service, "_Request", "_Reply", None, layouts, package)
    for action in interfaces.actions(layouts):
        yield _output(action, "_Command", "_Outcome", "_Progress", layouts, package)


def _output(
    name: TypeName, request: str, response: str, progress: str | None, layouts: Layouts, package: str
) -> Output:
    path = calls_header(name, package)
    endings = {"request": request, "response": response} | ({"progress": progress} if progress else {})
    messages = {member: name.part(ending) for member, ending in endings.items()}
    parts = tuple(Part(member, struct_name(one)) for member, one in messages.items())
    headers = [f"{package}/shmgen_client.h", f"{package}/shmgen_server.h"]
    view = Calls(
        title=str(name),
        origin=in_comment(layouts[messages["response"]].message.origin),
        guard=path.upper().replace("/", "_").replace(".", "_"),
        includes=(*headers, *sorted(ends_header(one, package) for one in messages.values())),
        name=calls_name(name),
        parts=parts,
        headed=parts[1:],
        number="goal" if progress else "call",
        request=parts[0].struct,
        response=parts[1].struct,
        progress=parts[2].struct if progress else "",
    )
    return Output(f"c/{path}", "c/calls.h.j2", view)
