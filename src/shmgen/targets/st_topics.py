"""Turns topics into the list of their blocks and the program that calls them: `st/GVL_Ros.st` and `st/PRG_Ros.st`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen.diagnostics import Report
from shmgen.model import Output, Topic
from shmgen.targets import naming


class Instance(NamedTuple):
    """The block of one topic; `declaration` is lined up with its neighbours, `topic` a literal."""

    name: str
    declaration: str
    topic: str
    depth: str


class Topics(NamedTuple):
    """Both files; `gvl` and `program` are their names."""

    instances: tuple[Instance, ...]
    gvl: str = naming.GVL_TOPICS
    program: str = naming.PRG_TOPICS


def plan(topics: Sequence[Topic], report: Report) -> Iterator[Output]:
    """Nothing where there are no topics. Reports SHM203."""
    _check_names(topics, report)
    if topics:
        view = Topics(tuple(_instances(topics)))
        yield Output(f"st/{naming.GVL_TOPICS}.st", "st/topics.st.j2", view)
        yield Output(f"st/{naming.PRG_TOPICS}.st", "st/program.st.j2", view)


def _instances(topics: Sequence[Topic]) -> Iterator[Instance]:
    """What comes to the PLC first."""
    names = [naming.st_topic(topic.name) for topic in topics]
    blocks = [naming.subscriber_block(it.type) if it.to_plc else naming.publisher_block(it.type) for it in topics]
    width, column = max(map(len, names)), max(map(len, blocks)) + 1
    for topic, name, block in sorted(zip(topics, names, blocks, strict=True), key=lambda found: not found[0].to_plc):
        declaration = f"{name:<{width}} : {block + ';':<{column}}  // {topic.name}, {topic.type}"
        yield Instance(name, declaration, f"'{topic.name}'", str(topic.depth))


def _check_names(topics: Sequence[Topic], report: Report) -> None:
    seen: dict[str, Topic] = {}
    for topic in topics:
        name = naming.st_topic(topic.name)
        other = seen.setdefault(name.upper(), topic)
        if other is not topic:
            report.error(
                "SHM203",
                f"topics {other.name} and {topic.name} are both `{name}` in Structured Text, which ignores case",
                topic.span,
                hint=naming.STRUCTURED_TEXT.way_out,
            )
