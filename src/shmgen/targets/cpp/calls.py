"""Generate the C++ headers for clients and servers of services and actions, on top of handwritten headers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen.core.model import Layouts, Output, TypeName
from shmgen.targets import interfaces
from shmgen.targets.c.text import in_comment
from shmgen.targets.cpp.names import class_name, header, namespace

_SERVICE = ("Request", "Response", "Reply"), ("Client", "Server")
_ACTION = ("Goal", "Feedback", "Result", "Command", "Progress", "Outcome"), ("ActionClient", "ActionServer")


class Calls(NamedTuple):
    """The template data for the header of a service or an action, as finished C++ code.

    `parts` are endings of message classes: `Request` stands for `<name>_Request`. `kinds` are the endings of the
    classes that the header defines: `Client` stands for `<name>Client`.
    """

    title: str
    origin: str
    guard: str
    includes: tuple[str, ...]
    open: tuple[str, ...]
    name: str
    parts: tuple[str, ...]
    kinds: tuple[str, ...]


def plan(layouts: Layouts, package: str) -> Iterator[Output]:
    """Yield a header for each service, `cpp/<package>/std_srvs/srv/set_bool_service.hpp`, and for each action.

    The endings `_service.hpp` and `_action.hpp` occur in no message's file name.
    """
    for service in interfaces.services(layouts):
        yield _output(service, "service", *_SERVICE, layouts, package)
    for action in interfaces.actions(layouts):
        yield _output(action, "action", *_ACTION, layouts, package)


def _output(
    name: TypeName, word: str, parts: Sequence[str], kinds: Sequence[str], layouts: Layouts, package: str
) -> Output:
    path = header(name, package).removesuffix(".hpp") + f"_{word}.hpp"
    runtime = {"service": "shmgen_calls.hpp", "action": "shmgen_actions.hpp"}[word]
    messages = [name.part(f"_{part}") for part in parts]
    view = Calls(
        title=str(name),
        origin=in_comment(layouts[messages[-1]].message.origin),
        guard=path.upper().replace("/", "_").replace(".", "_"),
        includes=(f"{package}/{runtime}", *sorted(header(part, package) for part in messages)),
        open=tuple(namespace(name, package).split("::")),
        name=class_name(name),
        parts=tuple(parts),
        kinds=tuple(kinds),
    )
    return Output(f"cpp/{path}", "cpp/calls.hpp.j2", view)
