"""Turns services and actions into blocks that call and serve them: `FB_std_srvs_SetBool_Client`, `…_Server`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.model import Layouts, Output, TypeName
from shmgen.targets import interfaces, naming
from shmgen.targets.st import common


class Carried(NamedTuple):
    """What one region carries: the structure, and the list with its constants."""

    dut: str
    gvl: str


class Service(NamedTuple):
    """A client or a server; the last three are names in each `gvl`."""

    name: str
    title: str
    request: Carried
    reply: Carried
    response: str
    type_name: str = naming.GVL_TYPE_NAME
    digest: str = naming.GVL_DIGEST
    size: str = naming.GVL_SIZE


class Action(NamedTuple):
    """The same for an action; `goal`, `feedback` and `result` are the structures of its three parts."""

    name: str
    title: str
    command: Carried
    progress: Carried
    outcome: Carried
    goal: str
    feedback: str
    result: str
    type_name: str = naming.GVL_TYPE_NAME
    digest: str = naming.GVL_DIGEST
    size: str = naming.GVL_SIZE


def plan(layouts: Layouts) -> Iterator[Output]:
    """Nothing where no service and no action was asked for."""
    services, actions = list(interfaces.services(layouts)), list(interfaces.actions(layouts))
    if services or actions:
        yield from common.by_hand("FB_ShmCaller", "FB_ShmServer")
    for name in services:
        yield from _service(name)
    for name in actions:
        yield from _action(name)


def parts(layouts: Layouts) -> frozenset[TypeName]:
    """The messages that travel in the regions of those services and actions, not as topics."""
    services = [name.part(ending) for name in interfaces.services(layouts) for ending in _OF_SERVICE]
    actions = [name.part(ending) for name in interfaces.actions(layouts) for ending in _OF_ACTION]
    return frozenset(services + actions)


_OF_SERVICE = ("_Request", "_Response", "_Reply")
_OF_ACTION = ("_Goal", "_Result", "_Feedback", "_Command", "_Progress", "_Outcome")


def _service(name: TypeName) -> Iterator[Output]:
    request, reply = _carried(name.part("_Request")), _carried(name.part("_Reply"))
    response = naming.st_type(name.part("_Response"))
    for block, template in ((naming.client_block(name), "client"), (naming.server_block(name), "server")):
        view = Service(block, name.short, request, reply, response)
        yield Output(f"st/{name.package}/{block}.st", f"st/{template}.st.j2", view)


def _action(name: TypeName) -> Iterator[Output]:
    command, progress, outcome = (_carried(name.part(part)) for part in ("_Command", "_Progress", "_Outcome"))
    goal, feedback, result = (naming.st_type(name.part(part)) for part in ("_Goal", "_Feedback", "_Result"))
    for block, template in (
        (naming.action_client_block(name), "action_client"),
        (naming.action_server_block(name), "action_server"),
    ):
        view = Action(block, name.short, command, progress, outcome, goal, feedback, result)
        yield Output(f"st/{name.package}/{block}.st", f"st/{template}.st.j2", view)


def _carried(name: TypeName) -> Carried:
    return Carried(naming.st_type(name), naming.gvl(name))
