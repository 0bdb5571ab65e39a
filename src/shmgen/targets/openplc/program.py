"""Turns topics, services and actions into the program that calls their blocks, its task, and the structures that other
programs use.

Neither open compiler calls a block that is global, so that the blocks are the program's own; what a program for CODESYS
reads and writes as `GVL_Ros.robot_pose.Msg` is here a member of a global structure, under the same name.
"""

from __future__ import annotations

from typing import NamedTuple

from shmgen.core.model import Layout
from shmgen.targets import Job, Source
from shmgen.targets.openplc import calls, names
from shmgen.targets.openplc.blocks import Block, Blocks, Variable, pair
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.openplc.types import Structure, constants, ordered
from shmgen.targets.st.calls import parts
from shmgen.targets.st.names import gvl
from shmgen.targets.st.program import Use, uses

RESOURCE = "Res0"
TASK = "RosTask"


class Instance(NamedTuple):
    """A block under its topic's name; the lines before and behind its call copy between it and the structure."""

    name: str
    block: str
    call: tuple[str, ...]
    behind: tuple[str, ...]


class Program(NamedTuple):
    """`structures` are the types of the `variables`, which are global; `own` is the user's, called behind ours."""

    name: str
    structures: tuple[Structure, ...]
    variables: tuple[Variable, ...]
    instances: tuple[Instance, ...]
    interval: str
    own: tuple[Source, ...]
    resource: str = RESOURCE
    task: str = TASK


def blocks(job: Job, compiler: Compiler) -> tuple[Block, ...]:
    """A pair for each message that was asked for, but for the parts of services and actions, which have their own."""
    called = parts(job.layouts) - {topic.type for topic in job.topics}
    carried = [one for one in ordered(job.layouts) if one.requested and one.name not in called]
    known = Blocks(job, compiler)
    pairs = [block for layout in carried for block in pair(layout, job.layouts, compiler, known)]
    return (*pairs, *calls.blocks(job.layouts, compiler, known))


def plan(job: Job, compiler: Compiler, blocks: tuple[Block, ...]) -> Program | None:
    """None where shmgen.toml lists no topic, service or action."""
    if not job.uses:
        return None
    known = {block.name: block for block in blocks}
    structures: dict[str, Structure] = {}
    members, instances = [], []
    for use in uses(job.topics, job.services, job.actions):
        block = known[names.whole(use.block)]
        stored = _stored(block)
        structures[stored.name] = stored
        members.append(Variable(names.topic(use.name), stored.name, use.comment))
        instances.append(_instance(block, use))
    every = Structure("ST_Ros", "what the topics, services and actions carry", tuple(members))
    lists = [one for layout in ordered(job.layouts) if (one := _constants(layout, compiler))]
    return Program(
        names.PROGRAM,
        (*structures.values(), every, *(structure for structure, _ in lists)),
        (Variable(names.GLOBALS, every.name, every.doc), *(variable for _, variable in lists)),
        tuple(instances),
        str(job.options.task_interval),
        job.options.sources,
    )


_HELD = {"xEnable", "sTopic", "sService", "sAction", "udiDepth"}
"""Inputs that the call gives."""
_WHEN = {
    "Msg": "{0}.xNewData",
    "Request": "{0}.xExecute",
    "Goal": "{0}.xExecute",
    "Response": "{0}.xDone",
    "Feedback": "{0}.xNewFeedback",
    "Result": "{0}.xDone OR {0}.xAborted OR {0}.xError",
}
"""When a message that a block puts out can be new."""


def _stored(block: Block) -> Structure:
    """The structure with a block's outputs and those inputs that are the user's."""
    kept = [variable for variable in (*block.inputs, *block.outputs) if variable.name not in _HELD]
    return Structure(f"ST_Of_{block.name}", f"inputs and outputs of {block.name}", tuple(kept))


def _instance(block: Block, use: Use) -> Instance:
    name = names.topic(use.name)
    held = f"{names.GLOBALS}.{name}"
    call = ["xEnable := TRUE,", *use.inputs]
    inputs = [f"{one.name} := {held}.{one.name}" for one in block.inputs if one.name not in _HELD]
    if inputs:
        call[-1] = call[-1].removesuffix(");") + ","
        call += [f"{one}," for one in inputs[:-1]] + [f"{inputs[-1]});"]
    behind = []
    for one in (variable.name for variable in block.outputs):
        line = f"{held}.{one} := {name}.{one};"
        when = _WHEN.get(one, "").format(name)
        behind += [f"IF {when} THEN", f"    {line}", "END_IF;"] if when else [line]
    return Instance(name, block.name, tuple(call), tuple(behind))


def _constants(layout: Layout, compiler: Compiler) -> tuple[Structure, Variable] | None:
    """A structure whose members begin as the constants, for the dialects have no list that is a namespace."""
    members = constants(layout, compiler)
    if not members:
        return None
    name = names.whole(gvl(layout.name))
    stored = Structure("ST_" + name, f"constants of {layout.name}", members)
    return stored, Variable(name, stored.name, stored.doc)
