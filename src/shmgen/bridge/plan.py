"""Turns shmgen.toml into routes: for each topic what ROS has to know, and the class that moves its bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from shmgen import pipeline, resolve
from shmgen.bridge.backend import ServiceWire, Wire
from shmgen.bridge.side import About
from shmgen.config import Config
from shmgen.config.entries import Topic
from shmgen.diagnostics import Report
from shmgen.live.classes import generated
from shmgen.model import Clock, Layouts, Ref, Schema, Service, TypeName, element_of
from shmgen.model import Message as Definition
from shmgen.runtime import Message, ValueRejected, region_name
from shmgen.runtime.names import region_file

F = TypeVar("F")

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


@dataclass(frozen=True, slots=True)
class ServiceRoute:
    """A service both ways of looking at it; `kinds` are the classes of its `_Request`, `_Response` and `_Reply`."""

    service: Service
    wire: ServiceWire
    kinds: Mapping[str, type[Message]]


def routes(config: Config) -> list[Route]:
    """One for each of [[topics]]. Raises Rejected."""
    if not config.topics:
        return []
    requests = [topic.type for topic in config.topics]
    schema, layouts, found = _found(config, requests, resolve.topics)
    # Strings are cut by the bridge, which counts it, and not by the classes.
    kinds = generated(replace(config, types=replace(config.types, overflow="error")), requests)
    made = []
    for topic, typed in zip(config.topics, found, strict=True):
        messages = closure(schema, typed.type)
        wire = Wire(topic.topic, messages, topic.carried.qos, topic.carried.latch, topic.depth)
        made.append(Route(topic, wire, kinds[str(typed.type)], layouts, _stamp(messages[-1])))
    return made


def services(config: Config) -> list[ServiceRoute]:
    """One for each of [[services]]. Raises Rejected."""
    if not config.services:
        return []
    requests = [service.type for service in config.services]
    schema, _, found = _found(config, requests, resolve.services)
    kinds = generated(config, requests)

    def route(service: Service) -> ServiceRoute:
        halves = (closure(schema, service.type.part(part)) for part in ("_Request", "_Response"))
        parts = {part: kinds[str(service.type.part(part))] for part in ("_Request", "_Response", "_Reply")}
        return ServiceRoute(service, ServiceWire(service.name, *halves), parts)

    return [route(service) for service in found]


def diagnostics(config: Config) -> Wire:
    """The topic /diagnostics. Raises Rejected where the definitions in reach have no DiagnosticArray."""
    schema = pipeline.read(config, [DIAGNOSTICS])
    return Wire("/diagnostics", closure(schema, TypeName("diagnostic_msgs", "msg", "DiagnosticArray")))


def closure(schema: Schema, name: TypeName) -> tuple[Definition, ...]:
    """The message and all it holds, dependencies first."""
    wanted = {name}
    for message in reversed(schema.messages):
        if message.name in wanted:
            held = (element_of(field.type) for field in message.fields)
            wanted |= {element.name for element in held if isinstance(element, Ref)}
    return tuple(message for message in schema.messages if message.name in wanted)


def about(route: Route) -> About:
    """What the bridge says of it."""
    way = "-> PLC" if route.to_plc else "<- PLC"
    return About(route.topic.topic, way, route.wire.type.short, region_file(region_name(route.topic.topic)))


def check(route: Route, message: Any) -> None:
    """Raises ValueError if `message`, an empty one of a ROS, is not of the definition that shmgen knows."""
    if why := _misfit(route.kind, message):
        raise ValueError(
            f"{route.topic.topic}: {route.wire.type.short} of this ROS is not the one that shmgen knows: {why}\n"
            '  hint: set source = "..." in shmgen.toml to the ROS that runs here, generate, rebuild both sides'
        )


def _found(
    config: Config, requests: Iterable[str], find: Callable[[Config, Layouts, Report], Iterable[F]]
) -> tuple[Schema, Layouts, list[F]]:
    """The definitions as written, their layouts, and what `find` makes of shmgen.toml with them. Raises Rejected."""
    layouts = pipeline.lay_out(config, requests)
    report = Report()
    found = list(find(config, layouts, report))
    report.stop_if_any()
    return pipeline.read(config, requests), layouts, found


def _misfit(kind: type[Message], message: Any) -> str:
    try:
        room = bytearray(kind())
        kind._encode(message, room, 0, [])
        kind._decode(bytes(len(room)), 0, message)
    except (ValueRejected, AttributeError) as error:
        return str(error)
    return ""


def _stamp(message: Definition) -> tuple[str, ...]:
    """`header.stamp`, or a field `stamp` of its own."""
    for field in message.fields:
        if field.name == "header" and isinstance(field.type, Ref) and field.type.name.short == _HEADER:
            return ("header", "stamp")
        if field.name == "stamp" and field.type is Clock.TIME:
            return ("stamp",)
    return ()
