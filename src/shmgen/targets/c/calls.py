"""Generate the C headers for clients and servers of services and actions, on top of handwritten headers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layouts, Output, TypeName
from shmgen.targets import interfaces
from shmgen.targets.c.names import calls_header, calls_name, ends_header, struct_name
from shmgen.targets.c.text import Head, head


class Part(NamedTuple):
    """A member of the C structure shmgen_interface, such as `request`, and the name of its messages' C structure."""

    member: str
    struct: str


class Calls(NamedTuple):
    """The template data for the header of a service or an action.

    The regions of a service or an action contain up to three messages. `request`, `response` and `progress` are the
    names of their C structures. `progress` is `""` for a service. `number` is the name of the field that
    contains the number of the call or goal. `headed` lists the messages that begin with this field.
    """

    head: Head
    name: str
    parts: tuple[Part, ...]
    headed: tuple[Part, ...]
    number: str
    request: str
    response: str
    progress: str
    ends: tuple[str, ...] = ("client", "server")


def plan(layouts: Layouts, package: str) -> Iterator[Output]:
    """Yield a header for each service, `c/<package>/std_srvs/srv/set_bool_service.h`, and for each action.

    The endings `_service.h` and `_action.h` occur in no message's file name.
    """
    for name in interfaces.complete(layouts):
        yield _output(name, layouts, package)


def _output(name: TypeName, layouts: Layouts, package: str) -> Output:
    path = calls_header(name, package)
    messages = {member: name.part(ending) for member, ending in interfaces.REGIONS[name.kind].items()}
    parts = tuple(Part(member, struct_name(one)) for member, one in messages.items())
    includes = [f"{package}/shmgen_client.h", f"{package}/shmgen_server.h"]
    includes += sorted(ends_header(one, package) for one in messages.values())
    summary = f"{name} in shared memory: {calls_name(name)}_client and _server."
    view = Calls(
        head=head(summary, layouts[messages["response"]].message.origin, path, includes),
        name=calls_name(name),
        parts=parts,
        headed=parts[1:],
        number="goal" if "progress" in messages else "call",
        request=parts[0].struct,
        response=parts[1].struct,
        progress=parts[2].struct if "progress" in messages else "",
    )
    return Output(f"c/{path}", "c/calls.h.j2", view)
