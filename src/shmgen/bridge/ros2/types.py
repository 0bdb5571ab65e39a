"""The installed classes of rosidl, which say how a type is called and how it looks in this ROS.

The messages themselves cross as bytes, by cdr.py: what rosidl's classes hold is made by nobody but rclpy's services.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from typing import Any

from shmgen.bridge.backend import ServiceWire
from shmgen.core.model import (
    Array,
    Clock,
    Element,
    Field,
    Message,
    Ref,
    Scalar,
    Sequence,
    String,
    TypeName,
    assert_never,
)
from shmgen.core.type_hash import FILLER, TIMES


def message(messages: tuple[Message, ...]) -> Any:
    """The class of the last of `messages`. Raises ValueError if it, or one in it, is not installed or otherwise."""
    for definition in messages:
        _compare(_installed(definition.name), [definition])
    return _installed(messages[-1].name)


def service(wire: ServiceWire) -> Any:
    """The class of the service. Raises ValueError as message()."""
    kind = _installed(wire.type)
    for half, messages in (("Request", wire.request), ("Response", wire.response)):
        *held, own = messages
        for definition in held:
            _compare(_installed(definition.name), [definition])
        _compare(getattr(kind, half), [own])
    return kind


def _installed(name: TypeName) -> Any:
    try:
        module = import_module(f"{name.package}.{name.kind}")
        whole, is_part, _ = name.name.partition("_")
        if name.kind == "action" and is_part:  # the package offers the whole alone
            module = import_module(getattr(module, whole).__module__)
        return getattr(module, name.name)
    except (AttributeError, ImportError) as error:
        hint = "build its package and source the workspace, or set source to the ROS that runs here"
        raise ValueError(f"{name} is not installed in this ROS: {error}\n  hint: {hint}") from None


def _compare(kind: Any, definitions: Iterable[Message]) -> None:
    for definition in definitions:
        theirs = {name: type_ for name, type_ in kind.get_fields_and_field_types().items() if name != FILLER}
        ours = {field.name: _spelled(field) for field in definition.fields}
        if list(theirs.items()) != list(ours.items()):
            pairs = [f"{type_} {name}" for name, type_ in theirs.items()]
            wanted = [f"{type_} {name}" for name, type_ in ours.items()]
            raise ValueError(
                f"{definition.name} of this ROS has {', '.join(pairs) or 'no fields'}, and not {', '.join(wanted)}\n"
                '  hint: set source = "..." in shmgen.toml to the ROS that runs here, generate, rebuild both sides'
            )


def _spelled(field: Field) -> str:
    """As rosidl_generator_py has it: `sequence<double, 3>`."""
    match field.type:
        case Array(inner, length):
            return f"{_element(inner, field.word)}[{length}]"
        case Sequence(inner, capacity):
            return f"sequence<{_element(inner, field.word)}{f', {capacity}' if capacity else ''}>"
        case inner:
            return _element(inner, field.word)


def _element(type_: Element, word: str) -> str:
    match type_:
        case Scalar():
            plain = {Scalar.BOOL: "boolean", Scalar.FLOAT32: "float", Scalar.FLOAT64: "double"}.get(type_, type_.value)
            return {"byte": "octet"}.get(word, word or plain)
        case String(capacity, wide):
            return ("wstring" if wide else "string") + (f"<{capacity}>" if capacity else "")
        case Clock():
            return TIMES[type_].short
        case Ref(name):
            return name.short
        case _:
            assert_never(type_)
