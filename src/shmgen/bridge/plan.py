"""Plans the routes of shmgen.toml: the ROS side and the PLC side of each topic, service and action."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from shmgen.bridge.backend import ActionWire, ServiceWire, Wire
from shmgen.bridge.codec.direct import direct_codec
from shmgen.config.entries import TopicEntry
from shmgen.core.diagnostics import Report
from shmgen.core.model import Call, Clock, Layouts, Ref, Schema, TypeName, element_of
from shmgen.core.model import Message as Definition
from shmgen.generator import resolve
from shmgen.live.session import Session
from shmgen.runtime import Message, ValueRejected, region_name
from shmgen.runtime.region.names import region_file

_HEADER = "std_msgs/Header"
_ACTION_PARTS = ("_Goal", "_Result", "_Feedback", "_Command", "_Progress", "_Outcome")


@dataclass(frozen=True, slots=True)
class About:
    """A topic, service or action as text for the user: name, direction such as `-> PLC`, type, and region file."""

    name: str
    direction: str
    type: str
    region: str


@dataclass(frozen=True, slots=True)
class Route:
    """The plan for one topic. `kind` is the sample class. `stamp` is the path to the time stamp field, or empty."""

    topic: TopicEntry
    wire: Wire
    kind: type[Message]
    stamp: tuple[str, ...]

    @property
    def to_plc(self) -> bool:
        return self.topic.direction == "to_plc"

    @property
    def key(self) -> tuple[Any, ...]:
        """The values that identify this topic. A reload restarts the topic only if one of these values has changed."""
        return *self.region_key, self.topic.type, self.topic.carried

    @property
    def region_key(self) -> tuple[Any, ...]:
        """The values that identify the topic's region. A reload keeps the region open if these values are unchanged."""
        return self.topic.topic, self.topic.direction, self.topic.depth, self.kind._digest_

    @property
    def about(self) -> About:
        direction, region = "-> PLC" if self.to_plc else "<- PLC", region_file(region_name(self.topic.topic))
        return About(self.topic.topic, direction, self.wire.type.short, region)


@dataclass(frozen=True, slots=True)
class CallRoute:
    """The plan for one service or action. `kinds` maps the suffix of a message type, such as `_Goal`, to the class."""

    entry: Call
    wire: Any
    kinds: Mapping[str, type[Message]]

    @property
    def key(self) -> tuple[Any, ...]:
        """The values that identify this service or action. A reload restarts it only if a value has changed."""
        digests = tuple(kind._digest_ for kind in self.kinds.values())
        return self.entry.name, self.entry.type, self.entry.on_plc, self.entry.timeout, digests

    @property
    def about(self) -> About:
        direction = "PLC serves" if self.entry.on_plc else "PLC calls"
        half = "request" if self.entry.type.kind == "srv" else "goal"
        region = region_file(f"{region_name(self.entry.name)}-{half}")
        return About(self.entry.name, direction, self.entry.type.short, region)


def everything(session: Session, resolve: Callable[[str], str]) -> list[Route | CallRoute]:
    """Return the routes of all topics, services and actions in shmgen.toml. Raises Rejected if an entry has errors.

    `resolve` maps a name in shmgen.toml to the name in the ROS graph. The region keeps the name from shmgen.toml.
    """
    planned: list[Any] = [*routes(session), *services(session), *actions(session)]
    return [replace(route, wire=replace(route.wire, name=resolve(route.wire.name))) for route in planned]


def routes(session: Session) -> list[Route]:
    """Return a route for each entry of [[topics]]. Raises Rejected if an entry has errors."""
    # The bridge truncates strings itself, so that it can count them. The classes raise an error instead.
    topics, schema, layouts, kinds = _resolve(session, resolve.topics, overflow="error")

    def route(topic: TopicEntry, type_: TypeName) -> Route:
        messages, kind, carried = closure(schema, type_), kinds[str(type_)], topic.carried
        stamp = _stamp(messages[-1])
        accepts = carried.other_definition == "accept"
        direct = direct_codec(kind, stamp if carried.stamp == "now" else ())
        size = layouts[type_].size
        wire = Wire(topic.topic, messages, carried.qos, carried.latch, topic.depth, size, accepts, direct)
        return Route(topic, wire, kind, stamp)

    return [route(topic, typed.type) for topic, typed in zip(session.config.topics, topics, strict=True)]


def services(session: Session) -> list[CallRoute]:
    """Return a route for each entry of [[services]]. Raises Rejected if an entry has errors."""
    entries, schema, _, kinds = _resolve(session, resolve.services)

    def route(service: Call) -> CallRoute:
        request, response = (closure(schema, service.type.part(part)) for part in ("_Request", "_Response"))
        parts = {part: kinds[str(service.type.part(part))] for part in ("_Request", "_Response", "_Reply")}
        return CallRoute(service, ServiceWire(service.name, request, response), parts)

    return [route(service) for service in entries]


def actions(session: Session) -> list[CallRoute]:
    """Return a route for each entry of [[actions]]. Raises Rejected if an entry has errors."""
    entries, schema, layouts, kinds = _resolve(session, resolve.actions)

    def route(action: Call) -> CallRoute:
        names = {part: action.type.part(part) for part in _ACTION_PARTS}
        goal, result, feedback = (closure(schema, names[part]) for part in _ACTION_PARTS[:3])
        size = max(layouts[name].size for name in names.values())
        parts = {part: kinds[str(name)] for part, name in names.items()}
        return CallRoute(action, ActionWire(action.name, goal, result, feedback, size), parts)

    return [route(action) for action in entries]


def _resolve(
    session: Session, find: Callable[..., Iterable[Any]], **options: Any
) -> tuple[list[Any], Schema, Layouts, Mapping[str, type[Message]]]:
    """Return the entries that `find` selects from shmgen.toml, and the schema, layouts and classes of all messages.

    The classes are empty if there is no entry. `options` are for the classes. Raises Rejected if an entry has errors.
    """
    types, report = session.config.types_used, Report()
    layouts = session.layouts(types)
    entries = list(find(session.config, layouts, report))
    report.stop_if_any()
    return entries, session.schema(types), layouts, session.classes(types, **options) if entries else {}


def own_topic(session: Session, name: str, type_: str, **options: Any) -> Wire:
    """Return the ROS side of a topic of the bridge itself. Raises Rejected if no definition of `type_` is found."""
    return Wire(name, session.schema([type_]).messages, **options)


def closure(schema: Schema, name: TypeName) -> tuple[Definition, ...]:
    """Return the definitions of the message `name` and of all messages it contains, dependencies first."""
    names = {name}
    for message in reversed(schema.messages):
        if message.name in names:
            elements = (element_of(field.type) for field in message.fields)
            names |= {element.name for element in elements if isinstance(element, Ref)}
    return tuple(message for message in schema.messages if message.name in names)


def check(route: Route, message: Any) -> None:
    """Raise ValueError if `message`, an empty ROS message, differs from shmgen's definition of the topic's type."""
    try:
        data = bytes(route.kind._from_object(message))
        route.kind._decode(bytes(len(data)), message)
    except (ValueRejected, AttributeError) as error:
        raise ValueError(
            f"{route.topic.topic}: {route.wire.type.short} of this ROS differs from shmgen's definition: {error}\n"
            '  hint: set source = "..." in shmgen.toml to the ROS that runs here, generate, rebuild both sides'
        ) from None


def _stamp(message: Definition) -> tuple[str, ...]:
    """Return the path to the time stamp: `header.stamp`, `stamp`, or empty if the message has neither."""
    for field in message.fields:
        if field.name == "header" and isinstance(field.type, Ref) and field.type.name.short == _HEADER:
            return ("header", "stamp")
        if field.name == "stamp" and field.type is Clock.TIME:
            return ("stamp",)
    return ()
