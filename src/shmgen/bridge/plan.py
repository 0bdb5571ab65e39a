"""Turns shmgen.toml into routes: for each topic what ROS has to know, and the class that moves its bytes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from shmgen import pipeline
from shmgen.bridge.backend import Wire
from shmgen.config import Config
from shmgen.config_entries import Topic
from shmgen.diagnostics import Report
from shmgen.model import Array, Clock, FieldType, Layouts, Ref, Schema, Sequence, TypeName
from shmgen.model import Message as Definition
from shmgen.runtime import Message, ValueRejected
from shmgen.tools.classes import generated

DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
_HEADER = "std_msgs/Header"


@dataclass(frozen=True, slots=True)
class Route:
    """A topic both ways of looking at it. `stamp` are the attributes that lead to its time stamp, if it has one."""

    topic: Topic
    wire: Wire
    kind: type[Message]
    layouts: Layouts
    stamp: tuple[str, ...]

    @property
    def to_plc(self) -> bool:
        return self.topic.direction == "to_plc"


def routes(config: Config) -> list[Route]:
    """One for each of [[topics]]. Raises Rejected."""
    requests = [topic.type for topic in config.topics]
    layouts = pipeline.lay_out(config, requests)
    report = Report()
    found = list(pipeline.topics(config, layouts, report))
    report.stop_if_any()
    schema = pipeline.read(config, requests)
    # Strings are cut by the bridge, which counts it, and not by the classes.
    kinds = generated(replace(config, types=replace(config.types, overflow="error")), requests)
    made = []
    for topic, typed in zip(config.topics, found, strict=True):
        messages = closure(schema, typed.type)
        wire = Wire(topic.topic, messages, topic.carried.qos, topic.carried.latch, topic.depth)
        made.append(Route(topic, wire, kinds[str(typed.type)], layouts, _stamp(messages[-1])))
    return made


def diagnostics(config: Config) -> Wire:
    """The topic /diagnostics. Raises Rejected where the definitions in reach have no DiagnosticArray."""
    schema = pipeline.read(config, [DIAGNOSTICS])
    return Wire("/diagnostics", closure(schema, TypeName("diagnostic_msgs", "msg", "DiagnosticArray")))


def closure(schema: Schema, name: TypeName) -> tuple[Definition, ...]:
    """The message and all it holds, dependencies first."""
    wanted = {name}
    for message in reversed(schema.messages):
        if message.name in wanted:
            wanted |= set(_held(field.type for field in message.fields))
    return tuple(message for message in schema.messages if message.name in wanted)


def misfit(kind: type[Message], message: Any) -> str:
    """Why `message`, an empty one of a ROS, is not of the definition that `kind` was made from; or nothing."""
    try:
        room = bytearray(kind())
        kind._encode(message, room, 0, [])
        kind._decode(bytes(len(room)), 0, message)
    except (ValueRejected, AttributeError) as error:
        return str(error)
    return ""


def _held(types: Iterable[FieldType]) -> Iterable[TypeName]:
    for type_ in types:
        element = type_.element if isinstance(type_, Array | Sequence) else type_
        if isinstance(element, Ref):
            yield element.name


def _stamp(message: Definition) -> tuple[str, ...]:
    """`header.stamp`, or a field `stamp` of its own."""
    for field in message.fields:
        if field.name == "header" and isinstance(field.type, Ref) and field.type.name.short == _HEADER:
            return ("header", "stamp")
        if field.name == "stamp" and field.type is Clock.TIME:
            return ("stamp",)
    return ()
