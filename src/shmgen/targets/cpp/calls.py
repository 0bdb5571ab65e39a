"""Generate the C++ headers for clients and servers of services and actions, on top of handwritten headers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layouts, Output, TypeName
from shmgen.targets import interfaces
from shmgen.targets.c.names import calls_header
from shmgen.targets.c.text import Head, head
from shmgen.targets.cpp.names import class_name, header, namespace

_PARTS = {
    "srv": ("Request", "Response", "Reply"),
    "action": ("Goal", "Feedback", "Result", "Command", "Progress", "Outcome"),
}
_KINDS = {"srv": ("Client", "Server"), "action": ("ActionClient", "ActionServer")}
_RUNTIME = {"srv": "shmgen_calls.hpp", "action": "shmgen_actions.hpp"}


class Calls(NamedTuple):
    """The template data for the header of a service or an action, as finished C++ code.

    `parts` are endings of message classes: `Request` stands for `<name>_Request`. `kinds` are the endings of the
    classes that the header defines: `Client` stands for `<name>Client`.
    """

    head: Head
    open: tuple[str, ...]
    name: str
    parts: tuple[str, ...]
    kinds: tuple[str, ...]


def plan(layouts: Layouts, package: str) -> Iterator[Output]:
    """Yield a header for each service, `cpp/<package>/std_srvs/srv/set_bool_service.hpp`, and for each action.

    The endings `_service.hpp` and `_action.hpp` occur in no message's file name.
    """
    for name in interfaces.complete(layouts):
        yield _output(name, layouts, package)


def _output(name: TypeName, layouts: Layouts, package: str) -> Output:
    path = calls_header(name, package).removesuffix(".h") + ".hpp"
    messages = [name.part(f"_{part}") for part in _PARTS[name.kind]]
    includes = [f"{package}/{_RUNTIME[name.kind]}", *sorted(header(part, package) for part in messages)]
    summary = f"Client and server of {name} in shared memory."
    view = Calls(
        head=head(summary, layouts[messages[-1]].message.origin, path, includes),
        open=tuple(namespace(name, package).split("::")),
        name=class_name(name),
        parts=_PARTS[name.kind],
        kinds=_KINDS[name.kind],
    )
    return Output(f"cpp/{path}", "cpp/calls.hpp.j2", view)
