"""Generate the list with the blocks of all topics, services and actions, and the program that calls the blocks.

The files are `st/GVL_Ros.st` and `st/PRG_Ros.st`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Call, Output, Topic
from shmgen.targets import Job
from shmgen.targets.st import common, names
from shmgen.targets.st.objects import Attribute, GlobalList, Gvl, Head, Variable, Variables
from shmgen.targets.st.text import MADE


class Instance(NamedTuple):
    """A block in the variable list `GVL_Ros`. `inputs` are the inputs of its call, as lines of Structured Text."""

    name: str
    inputs: tuple[str, ...]


class Program(NamedTuple):
    """The template data for the program that calls all blocks in `GVL_Ros`, and then the programs in `behind`."""

    instances: tuple[Instance, ...]
    behind: tuple[str, ...] = ()


def plan(job: Job) -> Iterator[Output]:
    """Yield the files `st/GVL_Ros.st` and `st/PRG_Ros.st`, or nothing if there is no topic, service or action."""
    all_uses = uses(job)
    if all_uses:
        doc = (
            f"// A block for each topic, service and action of shmgen.toml. {names.PRG_TOPICS} calls them; "
            "programs of your own",
            "// read and write the inputs and outputs of the blocks.",
            MADE,
        )
        variables = tuple(Variable(names.st_topic(use.name), use.block, "", (f"// {use.comment}",)) for use in all_uses)
        head = Head(doc, (Attribute("qualified_only"),))
        stored = GlobalList(names.GVL_TOPICS, head, Variables("VAR_GLOBAL", False, variables))
        yield Output(f"st/{names.GVL_TOPICS}.st", "st/gvl.st.j2", Gvl(stored, common.columns(variables)))
        instances = tuple(Instance(names.st_topic(use.name), ("xEnable := TRUE,", *use.inputs)) for use in all_uses)
        view = Program(instances)
        yield Output(f"st/{names.PRG_TOPICS}.st", "st/program.st.j2", view)


class Use(NamedTuple):
    """A topic, service or action of shmgen.toml, with the function block that transfers its data.

    `inputs` are lines of Structured Text: the inputs with which the program calls the block. `order` is False for a
    block that receives data for the PLC. The program calls these blocks first.
    """

    order: bool
    name: str
    block: str
    comment: str
    inputs: tuple[str, ...]


def uses(job: Job) -> list[Use]:
    """Return all topics, services and actions in the order in which the program calls their blocks."""
    return sorted(map(_use, job.uses), key=lambda use: use.order)


def _use(use: Topic | Call) -> Use:
    if isinstance(use, Topic):
        is_input, role = use.to_plc, "Subscriber" if use.to_plc else "Publisher"
        inputs: tuple[str, ...] = (f"sTopic := '{use.name}',", f"udiDepth := {use.depth});")
    else:
        is_action = use.type.kind == "action"
        is_input, role = use.on_plc, f"{'Action' if is_action else ''}{'Server' if use.on_plc else 'Client'}"
        inputs = (f"{'sAction' if is_action else 'sService'} := '{use.name}');",)
    return Use(not is_input, use.name, names.block_name(use.type, role), f"{use.name}, {use.type}", inputs)
