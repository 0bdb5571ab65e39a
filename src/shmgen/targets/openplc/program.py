"""Turns topics into the program that calls their blocks, its task, and the structures that other programs use.

Neither open compiler calls a block that is global, so that the blocks are the program's own; what a program for CODESYS
reads and writes as `GVL_Ros.robot_pose.Msg` is here a member of a global structure, under the same name.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.model import Layout, Topic
from shmgen.targets import Job
from shmgen.targets.openplc import names
from shmgen.targets.openplc.blocks import Block, Variable, pair
from shmgen.targets.openplc.dialect import Dialect
from shmgen.targets.openplc.types import Structure, constants, ordered
from shmgen.targets.st import calls
from shmgen.targets.st.names import gvl

RESOURCE = "Res0"
TASK = "RosTask"


class Instance(NamedTuple):
    """A block under its topic's name; the lines before and behind its call copy between it and the structure."""

    name: str
    block: str
    call: tuple[str, ...]
    behind: tuple[str, ...]


class Program(NamedTuple):
    """`structures` are the types of the `variables`, which are global; `left_out` is what has no block here."""

    name: str
    structures: tuple[Structure, ...]
    variables: tuple[Variable, ...]
    instances: tuple[Instance, ...]
    interval: str
    left_out: tuple[str, ...]
    resource: str = RESOURCE
    task: str = TASK


def carried(job: Job) -> Iterator[Layout]:
    """The messages that get a pair of blocks: those asked for, but for the parts of services and actions."""
    called = calls.parts(job.layouts) - {topic.type for topic in job.topics}
    for layout in ordered(job.layouts):
        if layout.requested and layout.name not in called:
            yield layout


def plan(job: Job, dialect: Dialect) -> Program | None:
    """None where shmgen.toml lists no topic."""
    if not job.topics:
        return None
    order = sorted(job.topics, key=lambda topic: not topic.to_plc)
    structures: dict[str, Structure] = {}
    members, instances = [], []
    for topic in order:
        block = pair(job.layouts[topic.type], job.layouts, dialect)[1 if topic.to_plc else 0]
        stored = _stored(block, topic)
        structures[stored.name] = stored
        members.append(Variable(names.topic(topic.name), stored.name, f"{topic.name}, {topic.type}"))
        instances.append(_instance(block, topic))
    every = Structure("ST_Ros", "what the topics carry", tuple(members))
    lists = [one for layout in ordered(job.layouts) if (one := _constants(layout, dialect))]
    return Program(
        names.PROGRAM,
        (*structures.values(), every, *(structure for structure, _ in lists)),
        (Variable(names.GLOBALS, every.name, every.doc), *(variable for _, variable in lists)),
        tuple(instances),
        str(job.options.task_interval),
        (*(f"{it.name}, {it.type}" for it in job.services), *(f"{it.name}, {it.type}" for it in job.actions)),
    )


_HELD = {"xEnable", "sTopic", "udiDepth"}
"""Inputs that the call gives."""


def _stored(block: Block, topic: Topic) -> Structure:
    """The structure with a block's outputs and those inputs that are the user's."""
    kept = [variable for variable in (*block.inputs, *block.outputs) if variable.name not in _HELD]
    return Structure(f"ST_Of_{block.name}", f"inputs and outputs of {block.name}", tuple(kept))


def _instance(block: Block, topic: Topic) -> Instance:
    name = names.topic(topic.name)
    held = f"{names.GLOBALS}.{name}"
    inputs = [variable.name for variable in block.inputs if variable.name not in _HELD]
    call = ["xEnable := TRUE", f"sTopic := '{topic.name}'", f"udiDepth := {topic.depth}"]
    call += [f"{one} := {held}.{one}" for one in inputs]
    ends = [","] * (len(call) - 1) + [");"]
    behind = []
    for one in (variable.name for variable in block.outputs):
        line = f"{held}.{one} := {name}.{one};"
        behind += [f"IF {name}.xNewData THEN", f"    {line}", "END_IF;"] if one == "Msg" else [line]
    return Instance(name, block.name, tuple(map(str.__add__, call, ends)), tuple(behind))


def _constants(layout: Layout, dialect: Dialect) -> tuple[Structure, Variable] | None:
    """A structure whose members begin as the constants, for the dialects have no list that is a namespace."""
    members = constants(layout, dialect)
    if not members:
        return None
    name = names.whole(gvl(layout.name))
    stored = Structure("ST_" + name, f"constants of {layout.name}", members)
    return stored, Variable(name, stored.name, stored.doc)
