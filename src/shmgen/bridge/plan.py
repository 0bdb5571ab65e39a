"""Plans the routes of shmgen.toml: for each topic, service and action what ROS must know and what moves its bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from shmgen.bridge import backend
from shmgen.bridge.backend import ActionWire, ServiceWire, Wire
from shmgen.bridge.codec.direct import short_way
from shmgen.config.entries import ActionEntry, ServiceEntry, TopicEntry
from shmgen.core.diagnostics import Report
from shmgen.core.model import Action, Clock, Layouts, Ref, Schema, Service, TypeName, element_of
from shmgen.core.model import Message as Definition
from shmgen.generator import resolve
from shmgen.live.session import Session
from shmgen.runtime import Message, ValueRejected, region_name
from shmgen.runtime.region.names import region_file

DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
_HEADER = "std_msgs/Header"
_OF_ACTION = ("_Goal", "_Result", "_Feedback", "_Command", "_Progress", "_Outcome")


@dataclass(frozen=True, slots=True)
class About:
    """What it is called in ROS, which way it goes, its type, and its region."""

    name: str
    way: str
    type: str
    region: str


@dataclass(frozen=True, slots=True)
class Route:
    """A topic both ways of looking at it. `stamp` are the attributes that lead to its time stamp, if it has one."""

    topic: TopicEntry
    wire: Wire
    kind: type[Message]
    layouts: Layouts
    stamp: tuple[str, ...]

    @property
    def to_plc(self) -> bool:
        return self.topic.direction == "to_plc"

    @property
    def key(self) -> tuple[Any, ...]:
        """The same as long as there is nothing to do anew."""
        topic = self.topic
        return topic.topic, topic.type, topic.direction, topic.depth, topic.carried, self.kind._digest_

    @property
    def about(self) -> About:
        way, region = "-> PLC" if self.to_plc else "<- PLC", region_file(region_name(self.topic.topic))
        return About(self.topic.topic, way, self.wire.type.short, region)


@dataclass(frozen=True, slots=True)
class ServiceRoute:
    """A service both ways of looking at it; `kinds` are the classes of its `_Request`, `_Response` and `_Reply`."""

    service: Service
    wire: ServiceWire
    kinds: Mapping[str, type[Message]]

    @property
    def key(self) -> tuple[Any, ...]:
        return _key(self.service, self.kinds)

    @property
    def about(self) -> About:
        return _about(self.service, "request")


@dataclass(frozen=True, slots=True)
class ActionRoute:
    """An action both ways of looking at it; `kinds` are the classes of its parts by their endings, `_Goal` first."""

    action: Action
    wire: ActionWire
    kinds: Mapping[str, type[Message]]

    @property
    def key(self) -> tuple[Any, ...]:
        return _key(self.action, self.kinds)

    @property
    def about(self) -> About:
        return _about(self.action, "goal")


def everything(session: Session) -> list[Route | ServiceRoute | ActionRoute]:
    """All of a configuration. Raises Rejected."""
    return [*routes(session), *services(session), *actions(session)]


def routes(session: Session) -> list[Route]:
    """One for each of [[topics]]. Raises Rejected."""
    config, requests = session.config, _requests(session)
    schema, layouts, report = session.schema(requests), session.layouts(requests), Report()
    found = list(resolve.topics(config, layouts, report))
    report.stop_if_any()
    # Strings are cut by the bridge, which counts it, and not by the classes.
    kinds = session.classes(requests, overflow="error") if found else {}
    made = []
    for topic, typed in zip(config.topics, found, strict=True):
        messages = closure(schema, typed.type)
        layout, kind, stamp = layouts[typed.type], kinds[str(typed.type)], _stamp(messages[-1])
        carried = topic.carried
        accepts = carried.other_definition == "accept"
        short = short_way(kind, layout, layouts, stamp if carried.stamp == "now" else ())
        wire = Wire(topic.topic, messages, carried.qos, carried.latch, topic.depth, layout.size, accepts, short)
        made.append(Route(topic, wire, kind, layouts, stamp))
    return made


def services(session: Session) -> list[ServiceRoute]:
    """One for each of [[services]]. Raises Rejected."""
    requests = _requests(session)
    schema, layouts, report = session.schema(requests), session.layouts(requests), Report()
    found = list(resolve.services(session.config, layouts, report))
    report.stop_if_any()
    kinds = session.classes(requests) if found else {}

    def route(service: Service) -> ServiceRoute:
        request, response = (closure(schema, service.type.part(part)) for part in ("_Request", "_Response"))
        parts = {part: kinds[str(service.type.part(part))] for part in ("_Request", "_Response", "_Reply")}
        return ServiceRoute(service, ServiceWire(service.name, request, response), parts)

    return [route(service) for service in found]


def actions(session: Session) -> list[ActionRoute]:
    """One for each of [[actions]]. Raises Rejected."""
    requests = _requests(session)
    schema, layouts, report = session.schema(requests), session.layouts(requests), Report()
    found = list(resolve.actions(session.config, layouts, report))
    report.stop_if_any()
    kinds = session.classes(requests) if found else {}

    def route(action: Action) -> ActionRoute:
        names = {part: action.type.part(part) for part in _OF_ACTION}
        goal, result, feedback = (closure(schema, names[part]) for part in _OF_ACTION[:3])
        room = max(layouts[name].size for name in names.values())
        parts = {part: kinds[str(name)] for part, name in names.items()}
        return ActionRoute(action, ActionWire(action.name, goal, result, feedback, room), parts)

    return [route(action) for action in found]


def diagnostics(session: Session) -> Wire:
    """The topic /diagnostics. Raises Rejected where the definitions in reach have no DiagnosticArray."""
    schema = session.schema([DIAGNOSTICS])
    return Wire("/diagnostics", closure(schema, TypeName("diagnostic_msgs", "msg", "DiagnosticArray")))


def largest(session: Session) -> int:
    """Bytes that a message of any of them may have on its way. Raises Rejected."""
    layouts = session.layouts(_requests(session)).values()
    return backend.largest(max((layout.size for layout in layouts), default=0))


def closure(schema: Schema, name: TypeName) -> tuple[Definition, ...]:
    """The message and all it holds, dependencies first."""
    wanted = {name}
    for message in reversed(schema.messages):
        if message.name in wanted:
            held = (element_of(field.type) for field in message.fields)
            wanted |= {element.name for element in held if isinstance(element, Ref)}
    return tuple(message for message in schema.messages if message.name in wanted)


def check(route: Route, message: Any) -> None:
    """Raises ValueError if `message`, an empty one of a ROS, is not of the definition that shmgen knows."""
    if why := _misfit(route.kind, message):
        raise ValueError(
            f"{route.topic.topic}: {route.wire.type.short} of this ROS is not the one that shmgen knows: {why}\n"
            '  hint: set source = "..." in shmgen.toml to the ROS that runs here, generate, rebuild both sides'
        )


def _key(called: Service | Action, kinds: Mapping[str, type[Message]]) -> tuple[Any, ...]:
    digests = tuple(kind._digest_ for kind in kinds.values())
    return called.name, called.type, called.on_plc, called.timeout, digests


def _about(called: Service | Action, half: str) -> About:
    way, region = "PLC serves" if called.on_plc else "PLC calls", f"{region_name(called.name)}-{half}"
    return About(called.name, way, called.type.short, region_file(region))


def _requests(session: Session) -> tuple[str, ...]:
    """All that the bridge carries, laid out together."""
    config = session.config
    entries: tuple[TopicEntry | ServiceEntry | ActionEntry, ...] = (*config.topics, *config.services, *config.actions)
    return tuple(entry.type for entry in entries)


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
