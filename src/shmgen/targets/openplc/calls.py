"""Turns services and actions into function blocks: clients and servers, whose bodies are those of call_bodies."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layouts
from shmgen.targets import interfaces
from shmgen.targets.openplc.blocks import Block, Blocks
from shmgen.targets.openplc.call_bodies import Call, calls, serves
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.st import names as st


def blocks(layouts: Layouts, compiler: Compiler, known: Blocks) -> Iterator[Block]:
    """Client and server of each service and action that was asked for."""
    for name in interfaces.services(layouts):
        request, reply = (layouts[name.part(part)] for part in ("_Request", "_Reply"))
        call = Call(name, layouts, compiler, request, reply, None)
        yield known.block(st.client_block(name), calls(call), call.needs)
        yield known.block(st.server_block(name), serves(call), call.needs)
    for name in interfaces.actions(layouts):
        parts = [layouts[name.part(part)] for part in ("_Command", "_Outcome", "_Progress")]
        call = Call(name, layouts, compiler, *parts)
        yield known.block(st.action_client_block(name), calls(call), call.needs)
        yield known.block(st.action_server_block(name), serves(call), call.needs)
