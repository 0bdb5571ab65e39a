"""Generate Python modules with the client and server of services and actions, based on shmgen.runtime."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
_SERVICE = {"_Reply": _BOTH, "_Request": ("", *_BOTH), "_Response": ("",)}
_ACTION = {"_Command": _BOTH, "_Feedback": ("",), "_Goal": ("",), "_Outcome": ("", *_BOTH), "_Progress": _BOTH}
"""The imported classes of a service and an action: the suffixes of the class names, by the ending of the message."""


def plan(layouts: Layouts, root: str) -> Iterator[Output]:
    """Yield a module for each service, `<root>/std_srvs/srv/_set_bool_service.py`, and for each action.

    The names of these files and classes cannot collide with the files and classes of messages.
    """
    for service in interfaces.services(layouts):
        origin = in_docstring(layouts[service.part("_Reply")].message.origin)
        view = Calls(str(service), origin, tuple(_imports(service, _SERVICE)), service.name)
        yield Output(_path(service, root), "python/service.py.j2", view)
    for action in interfaces.actions(layouts):
        origin = in_docstring(layouts[action.part("_Outcome")].message.origin)
        view = Calls(str(action), origin, tuple(_imports(action, _ACTION)), action.name)
        yield Output(_path(action, root), "python/action.py.j2", view)


def classes(layouts: Layouts) -> dict[str, list[str]]:
    """Map each module of a service or an action to the names of its client and server class, for `__init__.py`."""
    services = {_module(it): [f"{it.name}Client", f"{it.name}Server"] for it in interfaces.services(layouts)}
    actions = {_module(it): [f"{it.name}ActionClient", f"{it.name}ActionServer"] for it in interfaces.actions(layouts)}
    return services | actions


def _path(name: TypeName, root: str) -> str:
    return f"{root}/{python_member(name.package)}/{name.kind}/{_module(name)[1:]}.py"


def _module(name: TypeName) -> str:
    return f".{module(name)}_{'service' if name.kind == 'srv' else 'action'}"


def _imports(name: TypeName, parts: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
    yield from ("from shmgen import runtime", "")
    for part, endings in parts.items():
        message = name.part(part)
        yield from import_lines(f".{module(message)}", [message.name + ending for ending in endings])
