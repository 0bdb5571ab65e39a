"""The list of the blocks of topics, services and actions, and the program that calls them.

These are `st/GVL_Ros.st` and `st/PRG_Ros.st`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen.core.model import Action, Output, Service, Topic
from shmgen.targets.st import names
from shmgen.targets.st.objects import Attribute, GlobalList, Gvl, Head, Line, Variable, Variables
from shmgen.targets.st.text import MADE, uncommented


class Instance(NamedTuple):
    """A block; `inputs` are the lines that its call gives it."""

    name: str
    inputs: tuple[str, ...]


class Program(NamedTuple):
    """What calls the blocks in the list `gvl`, and the programs `behind` them."""

    name: str
    gvl: str
    instances: tuple[Instance, ...]
    behind: tuple[str, ...] = ()


def plan(topics: Sequence[Topic], services: Sequence[Service], actions: Sequence[Action]) -> Iterator[Output]:
    """Nothing where there is none of them."""
    found = uses(topics, services, actions)
    if found:
        doc = (
            f"// A block for each topic, service and action of shmgen.toml. {names.PRG_TOPICS} calls them; "
            "programs of your own",
            "// read and write what they carry.",
            MADE,
        )
        variables = tuple(Variable(names.st_topic(use.name), use.block, "", use.comment) for use in found)
        head = Head(uncommented(doc), (Attribute("qualified_only"),))
        stored = GlobalList(names.GVL_TOPICS, head, Variables("VAR_GLOBAL", False, variables))
        yield Output(f"st/{names.GVL_TOPICS}.st", "st/gvl.st.j2", Gvl(stored, doc, _lines(found)))
        instances = tuple(Instance(names.st_topic(use.name), ("xEnable := TRUE,", *use.inputs)) for use in found)
        view = Program(names.PRG_TOPICS, names.GVL_TOPICS, instances)
        yield Output(f"st/{names.PRG_TOPICS}.st", "st/program.st.j2", view)


class Use(NamedTuple):
    """A topic, service or action, and its block; `inputs` name it in the call. `order`: what comes to the PLC first."""

    order: bool
    name: str
    block: str
    comment: str
    inputs: tuple[str, ...]


def uses(topics: Sequence[Topic], services: Sequence[Service], actions: Sequence[Action]) -> list[Use]:
    """In the order of their calls."""
    return sorted([*map(_topic, topics), *map(_service, services), *map(_action, actions)], key=lambda use: use.order)


def _topic(topic: Topic) -> Use:
    block = names.subscriber_block(topic.type) if topic.to_plc else names.publisher_block(topic.type)
    inputs = (f"sTopic := '{topic.name}',", f"udiDepth := {topic.depth});")
    return Use(not topic.to_plc, topic.name, block, f"{topic.name}, {topic.type}", inputs)


def _service(service: Service) -> Use:
    block = names.server_block(service.type) if service.on_plc else names.client_block(service.type)
    comment = f"{service.name}, {service.type}"
    return Use(not service.on_plc, service.name, block, comment, (f"sService := '{service.name}');",))


def _action(action: Action) -> Use:
    block = names.action_server_block(action.type) if action.on_plc else names.action_client_block(action.type)
    comment = f"{action.name}, {action.type}"
    return Use(not action.on_plc, action.name, block, comment, (f"sAction := '{action.name}');",))


def _lines(uses: Sequence[Use]) -> tuple[Line, ...]:
    """In columns."""
    named = [(names.st_topic(use.name), use) for use in uses]
    width, column = max(len(name) for name, _ in named), max(len(use.block) for use in uses) + 1
    return tuple(Line(f"{name:<{width}} : {use.block + ';':<{column}}  // {use.comment}") for name, use in named)
