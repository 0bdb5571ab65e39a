"""Turns topics, services and actions into the list of their blocks and the program that calls them.

These are `st/GVL_Ros.st` and `st/PRG_Ros.st`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen.diagnostics import Report
from shmgen.model import Action, Output, Service, Topic
from shmgen.targets import naming


class Instance(NamedTuple):
    """A block; `declaration` is lined up with its neighbours, `inputs` are the lines that its call gives it."""

    name: str
    declaration: str
    inputs: tuple[str, ...]


class Instances(NamedTuple):
    """Both files; `gvl` and `program` are their names."""

    instances: tuple[Instance, ...]
    gvl: str = naming.GVL_TOPICS
    program: str = naming.PRG_TOPICS


def plan(
    topics: Sequence[Topic], services: Sequence[Service], actions: Sequence[Action], report: Report
) -> Iterator[Output]:
    """Nothing where there is none of them. Reports SHM203."""
    _check_names([*topics, *services, *actions], report)
    uses = [*map(_topic, topics), *map(_service, services), *map(_action, actions)]
    if uses:
        view = Instances(tuple(_instances(uses)))
        yield Output(f"st/{naming.GVL_TOPICS}.st", "st/topics.st.j2", view)
        yield Output(f"st/{naming.PRG_TOPICS}.st", "st/program.st.j2", view)


class _Use(NamedTuple):
    """`order`: what comes to the PLC first."""

    order: bool
    name: str
    block: str
    comment: str
    inputs: tuple[str, ...]


def _topic(topic: Topic) -> _Use:
    block = naming.subscriber_block(topic.type) if topic.to_plc else naming.publisher_block(topic.type)
    inputs = (f"sTopic := '{topic.name}',", f"udiDepth := {topic.depth});")
    return _Use(not topic.to_plc, topic.name, block, f"{topic.name}, {topic.type}", inputs)


def _service(service: Service) -> _Use:
    block = naming.server_block(service.type) if service.on_plc else naming.client_block(service.type)
    comment = f"{service.name}, {service.type}"
    return _Use(not service.on_plc, service.name, block, comment, (f"sService := '{service.name}');",))


def _action(action: Action) -> _Use:
    block = naming.action_server_block(action.type) if action.on_plc else naming.action_client_block(action.type)
    comment = f"{action.name}, {action.type}"
    return _Use(not action.on_plc, action.name, block, comment, (f"sAction := '{action.name}');",))


def _instances(uses: Sequence[_Use]) -> Iterator[Instance]:
    names = [naming.st_topic(use.name) for use in uses]
    width, column = max(map(len, names)), max(len(use.block) for use in uses) + 1
    for use, name in sorted(zip(uses, names, strict=True), key=lambda found: found[0].order):
        declaration = f"{name:<{width}} : {use.block + ';':<{column}}  // {use.comment}"
        yield Instance(name, declaration, ("xEnable := TRUE,", *use.inputs))


def _check_names(uses: Sequence[Topic | Service | Action], report: Report) -> None:
    seen: dict[str, Topic | Service | Action] = {}
    for use in uses:
        name = naming.st_topic(use.name)
        other = seen.setdefault(name.upper(), use)
        if other is not use:
            report.error(
                "SHM203",
                f"{_shown(other)} and {_shown(use)} are both `{name}` in Structured Text, which ignores case",
                use.span,
                hint=naming.STRUCTURED_TEXT.way_out,
            )


def _shown(use: Topic | Service | Action) -> str:
    return f"{type(use).__name__.lower()} {use.name}"
