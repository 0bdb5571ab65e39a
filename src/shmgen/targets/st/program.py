"""Turns topics, services and actions into the list of their blocks and the program that calls them.

These are `st/GVL_Ros.st` and `st/PRG_Ros.st`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen.model import Action, Output, Service, Topic
from shmgen.targets.st import names
from shmgen.targets.st.objects import Attribute, GlobalList, Gvl, Head, Line, Variable, Variables
from shmgen.targets.st.text import MADE, uncommented


class Instance(NamedTuple):
    """A block; `inputs` are the lines that its call gives it."""

    name: str
    inputs: tuple[str, ...]


class Program(NamedTuple):
    """What calls the blocks in the list `gvl`."""

    name: str
    gvl: str
    instances: tuple[Instance, ...]


def plan(topics: Sequence[Topic], services: Sequence[Service], actions: Sequence[Action]) -> Iterator[Output]:
    """Nothing where there is none of them."""
    uses = [*map(_topic, topics), *map(_service, services), *map(_action, actions)]
    if uses:
        uses.sort(key=lambda use: use.order)
        doc = (
            f"// A block for each topic, service and action of shmgen.toml. {names.PRG_TOPICS} calls them; "
            "programs of your own",
            "// read and write what they carry.",
            MADE,
        )
        variables = tuple(Variable(names.st_topic(use.name), use.block, "", use.comment) for use in uses)
        head = Head(uncommented(doc), (Attribute("qualified_only"),))
        stored = GlobalList(names.GVL_TOPICS, head, Variables("VAR_GLOBAL", False, variables))
        yield Output(f"st/{names.GVL_TOPICS}.st", "st/gvl.st.j2", Gvl(stored, doc, _lines(uses)))
        instances = tuple(Instance(names.st_topic(use.name), ("xEnable := TRUE,", *use.inputs)) for use in uses)
        view = Program(names.PRG_TOPICS, names.GVL_TOPICS, instances)
        yield Output(f"st/{names.PRG_TOPICS}.st", "st/program.st.j2", view)


class _Use(NamedTuple):
    """`order`: what comes to the PLC first."""

    order: bool
    name: str
    block: str
    comment: str
    inputs: tuple[str, ...]


def _topic(topic: Topic) -> _Use:
    block = names.subscriber_block(topic.type) if topic.to_plc else names.publisher_block(topic.type)
    inputs = (f"sTopic := '{topic.name}',", f"udiDepth := {topic.depth});")
    return _Use(not topic.to_plc, topic.name, block, f"{topic.name}, {topic.type}", inputs)


def _service(service: Service) -> _Use:
    block = names.server_block(service.type) if service.on_plc else names.client_block(service.type)
    comment = f"{service.name}, {service.type}"
    return _Use(not service.on_plc, service.name, block, comment, (f"sService := '{service.name}');",))


def _action(action: Action) -> _Use:
    block = names.action_server_block(action.type) if action.on_plc else names.action_client_block(action.type)
    comment = f"{action.name}, {action.type}"
    return _Use(not action.on_plc, action.name, block, comment, (f"sAction := '{action.name}');",))


def _lines(uses: Sequence[_Use]) -> tuple[Line, ...]:
    """In columns."""
    named = [(names.st_topic(use.name), use) for use in uses]
    width, column = max(len(name) for name, _ in named), max(len(use.block) for use in uses) + 1
    return tuple(Line(f"{name:<{width}} : {use.block + ';':<{column}}  // {use.comment}") for name, use in named)
