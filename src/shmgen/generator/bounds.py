"""Applies the bounds of the configuration to every string and sequence of a Schema."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace

from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Report, closest
from shmgen.core.model import (
    Array,
    Field,
    FieldType,
    Message,
    Ref,
    Schema,
    Sequence,
    String,
    TypeName,
    element_of,
)


def apply(schema: Schema, bounds: Bounds, report: Report, in_reach: Callable[[], Iterable[TypeName]] = tuple) -> Schema:
    """Return the schema with a bound for every string and sequence, from the definitions and the configuration.

    `in_reach` returns all available messages, to find keys that name none of these messages. Raises Rejected if a
    sequence is unbounded (SHM101), a field is bounded twice (SHM103), or a key names nothing (SHM502).
    """
    _check_keys(schema, bounds, in_reach, report)
    messages = tuple(
        replace(message, fields=tuple(_bounded(field, message.name, bounds) for field in message.fields))
        for message in schema.messages
    )
    paths = _paths(schema)
    for message in messages:
        for field in message.fields:
            if isinstance(field.type, Sequence) and field.type.capacity is None:
                key = f"{message.name.short}.{field.name}"
                change = "" if _is_foreign(message) else _how_to_bound(field)
                report.error(
                    "SHM101",
                    "unbounded sequence has no fixed size",
                    field.span,
                    field=f"{paths[message.name]}.{field.name}",
                    hint=f'{change}set "{key}" = N under [bounds] in shmgen.toml',
                )
    report.stop_if_any()
    return schema._replace(messages=messages)


def _how_to_bound(field: Field) -> str:
    """Return a hint to bound the field in its definition, in the syntax of .msg or .idl."""
    if field.written.endswith("[]"):
        return f"write `{field.written[:-2]}[<=N] {field.name}`, or "
    return f"write `{field.written[:-1]}, N> {field.name}`, or " if field.written.endswith(">") else ""


def _is_foreign(message: Message) -> bool:
    """Return True if the user cannot edit the definition, because it is built in or part of an installed ROS."""
    return message.origin.startswith("built-in") or message.origin.endswith((" of ROS 1", " of ROS 2"))


def without_unbounded(schema: Schema, bounds: Bounds, used: Collection[TypeName]) -> Schema:
    """Drop requested messages that still need a bound, and keep the other requested messages with their dependencies.

    Messages in `used` always stay. A service or action is kept or dropped with all its parts.
    """
    missing = unbounded(schema, bounds)
    lacking = {_whole(name) for name in schema.requested if missing[name] and name not in used}
    requested = frozenset(name for name in schema.requested if name in used or _whole(name) not in lacking)
    needed = set(requested)
    for message in reversed(schema.messages):  # a message comes after its dependencies
        if message.name in needed:
            elements = [element_of(field.type) for field in message.fields]
            needed |= {element.name for element in elements if isinstance(element, Ref)}
    return Schema(tuple(message for message in schema.messages if message.name in needed), requested)


def _whole(name: TypeName) -> TypeName:
    return name if name.kind == "msg" else name._replace(name=name.name.rpartition("_")[0])


def unbounded(schema: Schema, bounds: Bounds) -> dict[TypeName, tuple[str, ...]]:
    """Map each message to the keys that the user must add to [bounds] before the message can be generated.

    A key names an unbounded sequence of the message or of one of its dependencies.
    """
    missing: dict[TypeName, tuple[str, ...]] = {}
    for message in schema.messages:  # dependencies first
        keys: dict[str, None] = {}
        for field in message.fields:
            bounded = _bounded(field, message.name, bounds).type
            if isinstance(bounded, Sequence) and bounded.capacity is None:
                keys[f"{message.name.short}.{field.name}"] = None
            nested = element_of(bounded)
            if isinstance(nested, Ref):
                keys |= dict.fromkeys(missing[nested.name])
        missing[message.name] = tuple(keys)
    return missing


def defaulted(schema: Schema, bounds: Bounds) -> dict[TypeName, tuple[str, ...]]:
    """Map each message to the keys whose bound is only the `default` of [bounds].

    A key names a sequence of the message or of one of its dependencies.
    """
    return unbounded(schema, bounds._replace(default_sequence=None)) if bounds.default_sequence else {}


def _bounded(field: Field, message: TypeName, bounds: Bounds) -> Field:
    element = element_of(field.type)
    if isinstance(element, String) and element.capacity is None:
        capacity = _most_specific(bounds.strings, message, field.name, bounds.default_string)
        element = replace(element, capacity=capacity)
    bounded: FieldType
    match field.type:
        case Array(_, length):
            bounded = Array(element, length)
        case Sequence(_, None):
            bounded = Sequence(element, _most_specific(bounds.sequences, message, field.name, bounds.default_sequence))
        case Sequence(_, capacity):
            bounded = Sequence(element, capacity)
        case _:
            bounded = element
    return field if bounded == field.type else field._replace(type=bounded, sent=field.sent or field.type)


def _most_specific(table: Mapping[str, Bound], message: TypeName, field: str, default: int | None) -> int | None:
    keys = (f"{message.short}.{field}", message.short, message.package)
    return next((table[key].value for key in keys if key in table), default)


def _check_keys(schema: Schema, bounds: Bounds, in_reach: Callable[[], Iterable[TypeName]], report: Report) -> None:
    """Report keys in [bounds] and [strings] that name nothing, or a field whose definition has a bound.

    A key must name a package, a message or a field.
    """
    at_hand = {message.name.short: message for message in schema.messages}
    packages = {message.name.package for message in schema.messages}
    elsewhere: dict[str, Bound] = {}
    for section, table in (("bounds", bounds.sequences), ("strings", bounds.strings)):
        for key, bound in table.items():
            owner, dot, name = key.partition(".")
            if owner not in at_hand and owner not in packages:
                elsewhere[owner] = bound
            elif dot and owner in at_hand:
                _check_field_key(at_hand[owner], name, section, bound, report)
    if elsewhere:
        _check_owners(elsewhere, packages, in_reach(), report)


def _check_owners(
    owners: Mapping[str, Bound], at_hand: Collection[str], in_reach: Iterable[TypeName], report: Report
) -> None:
    """Report the keys of [bounds] or [strings], `owners`, whose package or message is unknown.

    `at_hand` are the packages of the messages in the schema. `in_reach` are all available messages.
    """
    messages = {name.short for name in in_reach}
    packages = {name.partition("/")[0] for name in messages}
    for owner, bound in owners.items() if messages else ():
        package, slash, _ = owner.partition("/")
        # A file requested by its path may belong to a package that is not in `in_reach`.
        if owner in packages or owner in messages or (slash and package in set(at_hand) - packages):
            continue
        kind, known = ("message", messages) if slash and package in packages else ("package", {*packages, *at_hand})
        name = owner if kind == "message" else package
        close = closest(name, known, 0.8)
        command = f"shmgen list {package}" if slash else "shmgen list"
        hint = f"did you mean {close}?" if close else f"`{command}` prints the known names"
        report.error("SHM502", f"unknown {kind} {name}", bound.span, hint=hint)


def _check_field_key(message: Message, name: str, section: str, bound: Bound, report: Report) -> None:
    field = next((field for field in message.fields if field.name == name), None)
    if field is None:
        close = closest(name, [field.name for field in message.fields])
        hint = f"did you mean {close}?" if close else f"`shmgen show {message.name.short}` lists its fields"
        report.error("SHM502", f"{message.name.short} has no field {name}", bound.span, hint=hint)
        return
    path = f"{message.name.short}.{name}"
    bounded = field.type if section == "bounds" else element_of(field.type)
    expected: type[Sequence | String] = Sequence if section == "bounds" else String
    noun = "sequence" if section == "bounds" else "string"
    if not isinstance(bounded, expected):
        report.error("SHM502", f"{path} is not a {noun}, but a {field.written}", bound.span, hint="remove this line")
    elif bounded.capacity not in (None, bound.value):
        problem = f"{path} is bounded to {bounded.capacity} by its definition ({field.written})"
        report.error("SHM103", problem, bound.span, hint="remove this line, or change the definition")


def _paths(schema: Schema) -> dict[TypeName, str]:
    """Map each message to the shortest path from a requested message, such as `demo_msgs/Robot.arm.joints[]`."""
    by_name = {message.name: message for message in schema.messages}
    paths = {name: name.short for name in sorted(schema.requested)}
    queue = list(paths)
    for name in queue:  # the loop extends the queue: breadth first, so the shortest path wins
        for field in by_name[name].fields:
            nested = element_of(field.type)
            if isinstance(nested, Ref) and nested.name not in paths:
                many = "[]" if isinstance(field.type, Array | Sequence) else ""
                paths[nested.name] = f"{paths[name]}.{field.name}{many}"
                queue.append(nested.name)
    return {name: paths.get(name, name.short) for name in by_name}
