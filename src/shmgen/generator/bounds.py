"""Gives every string and sequence of a Schema its bound, by the user's words."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace

from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Report, closest
from shmgen.core.model import (
    Array,
    Element,
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
    """The same messages, all bounded. Raises Rejected: SHM101 unbounded, SHM103 bound twice, SHM502 no such field.

    `in_reach` lists all messages there are, for keys that none at hand answers to; SHM502 if none of those does.
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
    return replace(schema, messages=messages)


def _how_to_bound(field: Field) -> str:
    """In the words of a .msg or of an .idl."""
    if field.written.endswith("[]"):
        return f"write `{field.written[:-2]}[<=N] {field.name}`, or "
    return f"write `{field.written[:-1]}, N> {field.name}`, or " if field.written.endswith(">") else ""


def _is_foreign(message: Message) -> bool:
    """Nobody can write into the built-in store, and hardly anybody into an installed ROS."""
    return message.origin.startswith("built-in") or message.origin.endswith((" of ROS 1", " of ROS 2"))


def without_unbounded(schema: Schema, bounds: Bounds, used: Collection[TypeName]) -> Schema:
    """The messages asked for that need no more bounds, and what these hold.

    Those `used` stay, whatever they need. Of a service or an action all parts stay, or none.
    """
    missing = unbounded(schema, bounds)
    lacking = {_whole(name) for name in schema.requested if missing[name] and name not in used}
    requested = frozenset(name for name in schema.requested if name in used or _whole(name) not in lacking)
    needed = set(requested)
    for message in reversed(schema.messages):  # what holds others comes after them
        if message.name in needed:
            elements = [element_of(field.type) for field in message.fields]
            needed |= {element.name for element in elements if isinstance(element, Ref)}
    return Schema(tuple(message for message in schema.messages if message.name in needed), requested)


def _whole(name: TypeName) -> TypeName:
    return name if name.kind == "msg" else name._replace(name=name.name.rpartition("_")[0])


def unbounded(schema: Schema, bounds: Bounds) -> dict[TypeName, tuple[str, ...]]:
    """For each message the keys that [bounds] still lacks for it and for what it holds, each once."""
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
    """For each message the keys, of its own and of what it holds, that the default of [bounds] answers for."""
    return unbounded(schema, replace(bounds, default_sequence=None)) if bounds.default_sequence else {}


def _bounded(field: Field, message: TypeName, bounds: Bounds) -> Field:
    def element(type_: Element) -> Element:
        if isinstance(type_, String) and type_.capacity is None:
            configured = _most_specific(bounds.strings, message, field.name)
            return replace(type_, capacity=configured.value if configured else bounds.default_string)
        return type_

    bounded: FieldType
    match field.type:
        case Array(inner, length):
            bounded = Array(element(inner), length)
        case Sequence(inner, None):
            configured = _most_specific(bounds.sequences, message, field.name)
            bounded = Sequence(element(inner), configured.value if configured else bounds.default_sequence)
        case Sequence(inner, capacity):
            bounded = Sequence(element(inner), capacity)
        case inner:
            bounded = element(inner)
    return field if bounded == field.type else replace(field, type=bounded, sent=field.sent or field.type)


def _most_specific(table: Mapping[str, Bound], message: TypeName, field: str) -> Bound | None:
    for key in (f"{message.short}.{field}", message.short, message.package):
        if key in table:
            return table[key]
    return None


def _check_keys(schema: Schema, bounds: Bounds, in_reach: Callable[[], Iterable[TypeName]], report: Report) -> None:
    """A key must name something that exists, and a field of a message at hand must be without a bound of its own."""
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
    """Packages and messages that are not part of this run must at least be there."""
    messages = {name.short for name in in_reach}
    packages = {name.partition("/")[0] for name in messages}
    for owner, bound in owners.items() if messages else ():
        package, slash, _ = owner.partition("/")
        # A file that was asked for by its path is of a package that is not in reach otherwise.
        if owner in packages or owner in messages or (slash and package in set(at_hand) - packages):
            continue
        kind, known = ("message", messages) if slash and package in packages else ("package", {*packages, *at_hand})
        name = owner if kind == "message" else package
        close = closest(name, known, 0.8)
        hint = (
            f"did you mean {close}?" if close else f"`shmgen list{f' {package}' if slash else ''}` prints what there is"
        )
        report.error("SHM502", f"there is no {kind} {name}", bound.span, hint=hint)


def _check_field_key(message: Message, name: str, section: str, bound: Bound, report: Report) -> None:
    field = next((field for field in message.fields if field.name == name), None)
    if field is None:
        close = closest(name, [field.name for field in message.fields])
        report.error(
            "SHM502",
            f"{message.name.short} has no field {name}",
            bound.span,
            hint=f"did you mean {close}?" if close else f"`shmgen show {message.name.short}` lists its fields",
        )
    elif section == "bounds" and not isinstance(field.type, Sequence):
        report.error("SHM502", f"{message.name.short}.{name} is not a sequence but {field.written}", bound.span)
    elif section == "strings" and not isinstance(element_of(field.type), String):
        report.error("SHM502", f"{message.name.short}.{name} is not a string but {field.written}", bound.span)
    else:
        bounded = field.type if section == "bounds" else element_of(field.type)
        assert isinstance(bounded, Sequence | String)
        if bounded.capacity is not None and bounded.capacity != bound.value:
            report.error(
                "SHM103",
                f"{message.name.short}.{name} is bounded to {bounded.capacity} by its definition ({field.written})",
                bound.span,
                hint="remove this line, or change the definition",
            )


def _paths(schema: Schema) -> dict[TypeName, str]:
    """How each message is reached from one the user named: `demo_msgs/Robot.arm.joints[]`."""
    by_name = {message.name: message for message in schema.messages}
    paths = {name: name.short for name in sorted(schema.requested)}
    queue = list(paths)
    for name in queue:  # grows while it is walked: breadth first, so the shortest path wins
        for field in by_name[name].fields:
            nested = element_of(field.type)
            if isinstance(nested, Ref) and nested.name not in paths:
                many = "[]" if isinstance(field.type, Array | Sequence) else ""
                paths[nested.name] = f"{paths[name]}.{field.name}{many}"
                queue.append(nested.name)
    return {name: paths.get(name, name.short) for name in by_name}
