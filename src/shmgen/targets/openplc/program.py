"""Generate the program that calls all blocks, its task, and the global structures that other programs use.

The open compilers STruC++ and matiec cannot call a global block, so the blocks are variables of the program. The user's
programs use the same names as in CODESYS, such as `GVL_Ros.robot_pose.Msg`. In CODESYS, `GVL_Ros` is a variable list
that contains the block `robot_pose`. Here, both are structures.
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


class Instance(NamedTuple):
    """A block that the program calls for the topic, service or action `name`. `block` is the block's type.

    The lines in `call` call the block with inputs from the global structure. The lines in `behind` copy the block's
    outputs to the global structure.
    """

    name: str
    block: str
    call: tuple[str, ...]
    behind: tuple[str, ...]


class Program(NamedTuple):
    """The template data for the program and its global variables.

    `structures` are the types of `variables`. `own` are files with the user's own programs, which the task calls after
    shmgen's program.
    """

    structures: tuple[Structure, ...]
    variables: tuple[Variable, ...]
    instances: tuple[Instance, ...]
    interval: str
    own: tuple[Source, ...]


def blocks(job: Job, compiler: Compiler) -> tuple[Block, ...]:
    """Return the publisher and subscriber block of each requested message, then the service and action blocks.

    Messages that only services and actions use get no publisher and subscriber block, except if a topic has their type.
    """
    called = parts(job.layouts) - {topic.type for topic in job.topics}
    carried = [one for one in ordered(job.layouts) if one.requested and one.name not in called]
    known = Blocks(job, compiler)
    pairs = [block for layout in carried for block in pair(layout, job.layouts, compiler, known)]
    return (*pairs, *calls.blocks(job.layouts, compiler, known))


def plan(job: Job, compiler: Compiler, blocks: tuple[Block, ...]) -> Program | None:
    """Return the program that calls `blocks`, or None if shmgen.toml lists no topic, service or action."""
    if not job.uses:
        return None
    known = {block.name: block for block in blocks}
    structures: dict[str, Structure] = {}
    members, instances = [], []
    for use in uses(job):
        block = known[names.whole(use.block)]
        stored = _structure_of(block)
        structures[stored.name] = stored
        members.append(Variable(names.topic(use.name), stored.name, use.comment))
        instances.append(_instance(block, use))
    every = Structure("ST_Ros", "the inputs and outputs of all topics, services and actions", tuple(members))
    lists = [one for layout in ordered(job.layouts) if (one := _constants(layout, compiler))]
    return Program(
        (*structures.values(), every, *(structure for structure, _ in lists)),
        (Variable(names.GLOBALS, every.name, every.doc), *(variable for _, variable in lists)),
        tuple(instances),
        str(job.options.task_interval),
        job.options.sources,
    )


_BLOCK_ONLY = {"xEnable", "sTopic", "sService", "sAction", "udiDepth"}
"""The inputs that the generated call sets."""
_WHEN = {
    "Msg": "{0}.xNewData",
    "Request": "{0}.xExecute",
    "Goal": "{0}.xExecute",
    "Response": "{0}.xDone",
    "Feedback": "{0}.xNewFeedback",
    "Result": "{0}.xDone OR {0}.xAborted OR {0}.xError",
}
"""The condition under which each message output of a block can be new."""


def _structure_of(block: Block) -> Structure:
    """Return the structure that the user's programs use instead of a block: the outputs, and the inputs of the user."""
    user_variables = [variable for variable in (*block.inputs, *block.outputs) if variable.name not in _BLOCK_ONLY]
    return Structure(f"ST_Of_{block.name}", f"inputs and outputs of {block.name}", tuple(user_variables))


def _instance(block: Block, use: Use) -> Instance:
    name = names.topic(use.name)
    global_name = f"{names.GLOBALS}.{name}"
    call = ["xEnable := TRUE,", *use.inputs]
    inputs = [f"{one.name} := {global_name}.{one.name}" for one in block.inputs if one.name not in _BLOCK_ONLY]
    if inputs:
        call[-1] = call[-1].removesuffix(");") + ","
        call += [f"{one}," for one in inputs[:-1]] + [f"{inputs[-1]});"]
    behind = []
    for one in (variable.name for variable in block.outputs):
        line = f"{global_name}.{one} := {name}.{one};"
        when = _WHEN.get(one, "").format(name)
        behind += [f"IF {when} THEN", f"    {line}", "END_IF;"] if when else [line]
    return Instance(name, block.name, tuple(call), tuple(behind))


def _constants(layout: Layout, compiler: Compiler) -> tuple[Structure, Variable] | None:
    """Return a structure whose members are the constants of a message, and a global variable of this structure.

    The variable has the name that the variable list of the constants has in CODESYS, so `GVL_pkg_Name.CONSTANT` works
    in both. The open compilers have no named variable lists. Return None if the message has no constants.
    """
    members = constants(layout, compiler)
    if not members:
        return None
    name = names.whole(gvl(layout.name))
    stored = Structure("ST_" + name, f"constants of {layout.name}", members)
    return stored, Variable(name, stored.name, stored.doc)
