"""Generate Python modules with the client and server of services and actions, based on shmgen.runtime."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layouts, Output, TypeName
from shmgen.targets import interfaces
from shmgen.targets.python.names import module, python_member
from shmgen.targets.python.text import import_lines, in_docstring


class Calls(NamedTuple):
    """The template data for a service or an action. The names of its classes begin with `name`, such as `SetBool`."""

    title: str
    origin: str
    imports: tuple[str, ...]
    name: str


_BOTH = ("Publisher", "Subscriber")
_IMPORTED = {
    "srv": {"_Reply": _BOTH, "_Request": ("", *_BOTH), "_Response": ("",)},
    "action": {"_Command": _BOTH, "_Feedback": ("",), "_Goal": ("",), "_Outcome": ("", *_BOTH), "_Progress": _BOTH},
}
"""The imported classes of a service and an action: the suffixes of the class names, by the ending of the message."""


def plan(layouts: Layouts, root: str) -> Iterator[Output]:
    """Yield a module for each service, `<root>/std_srvs/srv/_set_bool_service.py`, and for each action.

    The names of these files and classes cannot collide with the files and classes of messages.
    """
    for name in interfaces.complete(layouts):
        origin = layouts[name.part("_Reply" if name.kind == "srv" else "_Outcome")].message.origin
        path = f"{root}/{python_member(name.package)}/{name.kind}/{_module(name)}.py"
        view = Calls(str(name), in_docstring(origin), tuple(_imports(name)), name.name)
        yield Output(path, f"python/{_word(name)}.py.j2", view)


def classes(layouts: Layouts) -> dict[str, list[str]]:
    """Map each module of a service or an action to the names of its client and server class, for `__init__.py`."""
    prefixes = {"srv": "", "action": "Action"}
    names = ((f".{_module(name)}", name.name + prefixes[name.kind]) for name in interfaces.complete(layouts))
    return {module: [f"{name}Client", f"{name}Server"] for module, name in names}


def _module(name: TypeName) -> str:
    return f"{module(name)}_{_word(name)}"


def _word(name: TypeName) -> str:
    return "service" if name.kind == "srv" else "action"


def _imports(name: TypeName) -> Iterator[str]:
    yield from ("from shmgen import runtime", "")
    for part, endings in _IMPORTED[name.kind].items():
        message = name.part(part)
        yield from import_lines(f".{module(message)}", [message.name + ending for ending in endings])
