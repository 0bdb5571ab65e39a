"""Turns services and actions into blocks that call and serve them: `FB_std_srvs_SetBool_Client`, `…_Server`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layouts, Output, TypeName
from shmgen.targets import interfaces
from shmgen.targets.st import common, names
from shmgen.targets.st.counts import Check, checks


class Carried(NamedTuple):
    """What one region carries: the structure, and the list with its constants."""

    dut: str
    gvl: str


class Service(NamedTuple):
    """A client or a server, which looks at its counts if `fits`; the last three are names in each `gvl`."""

    name: str
    title: str
    request: Carried
    reply: Carried
    response: str
    fits: bool
    checks: tuple[Check, ...]
    type_name: str = names.GVL_TYPE_NAME
    digest: str = names.GVL_DIGEST
    size: str = names.GVL_SIZE


class Action(NamedTuple):
    """The same for an action; `goal`, `feedback` and `result` are the structures of its three parts.

    `fits` is of what ends or begins a goal, `fits_progress` of what a client hears meanwhile.
    """

    name: str
    title: str
    command: Carried
    progress: Carried
    outcome: Carried
    goal: str
    feedback: str
    result: str
    fits: bool
    fits_progress: bool
    checks: tuple[Check, ...]
    type_name: str = names.GVL_TYPE_NAME
    digest: str = names.GVL_DIGEST
    size: str = names.GVL_SIZE


def plan(layouts: Layouts) -> Iterator[Output]:
    """Nothing where no service and no action was asked for."""
    services, actions = list(interfaces.services(layouts)), list(interfaces.actions(layouts))
    if services or actions:
        yield from common.by_hand("FB_ShmClient", "FB_ShmServer")
    for name in services:
        yield from _service(name, layouts)
    for name in actions:
        yield from _action(name, layouts)


def parts(layouts: Layouts) -> frozenset[TypeName]:
    """The messages that travel in the regions of those services and actions, not as topics."""
    services = [name.part(ending) for name in interfaces.services(layouts) for ending in _OF_SERVICE]
    actions = [name.part(ending) for name in interfaces.actions(layouts) for ending in _OF_ACTION]
    return frozenset(services + actions)


_OF_SERVICE = ("_Request", "_Response", "_Reply")
_OF_ACTION = ("_Goal", "_Result", "_Feedback", "_Command", "_Progress", "_Outcome")


def _service(name: TypeName, layouts: Layouts) -> Iterator[Output]:
    request, reply = _carried(name.part("_Request"), layouts), _carried(name.part("_Reply"), layouts)
    response = names.st_type(name.part("_Response"), layouts[name.part("_Response")].options)
    for block, template, read in (
        (names.client_block(name), "client", "_Reply"),
        (names.server_block(name), "server", "_Request"),
    ):
        own = checks(layouts[name.part(read)], layouts, "Fits", read)
        view = Service(block, name.short, request, reply, response, bool(own), own)
        yield Output(f"st/{name.package}/{block}.st", f"st/{template}.st.j2", view)


def _action(name: TypeName, layouts: Layouts) -> Iterator[Output]:
    command, progress, outcome = (_carried(name.part(part), layouts) for part in ("_Command", "_Progress", "_Outcome"))
    goal, feedback, result = (
        names.st_type(name.part(part), layouts[name.part(part)].options) for part in ("_Goal", "_Feedback", "_Result")
    )
    for block, template, read, heard in (
        (names.action_client_block(name), "action_client", "_Outcome", ("_Progress",)),
        (names.action_server_block(name), "action_server", "_Command", ()),
    ):
        own = checks(layouts[name.part(read)], layouts, "Fits", read)
        also = tuple(it for part in heard for it in checks(layouts[name.part(part)], layouts, "FeedbackFits", part))
        parts = (command, progress, outcome, goal, feedback, result)
        view = Action(block, name.short, *parts, bool(own), bool(also), (*own, *also))
        yield Output(f"st/{name.package}/{block}.st", f"st/{template}.st.j2", view)


def _carried(name: TypeName, layouts: Layouts) -> Carried:
    return Carried(names.st_type(name, layouts[name].options), names.gvl(name))
