"""Imports the installed classes of ROS 2 types, which rclpy's services need, and compares their fields."""

from __future__ import annotations

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
    """Return the installed class of the last of `messages`. Raises ValueError if a type differs or is missing."""
    for definition in messages:
        _compare(_import_class(definition.name), definition)
    return _import_class(messages[-1].name)


def service(wire: ServiceWire) -> Any:
    """Return the installed class of the service. Raises ValueError if a type is missing or has other fields."""
    kind = _import_class(wire.type)
    for half, messages in (("Request", wire.request), ("Response", wire.response)):
        *dependencies, own = messages
        for definition in dependencies:
            _compare(_import_class(definition.name), definition)
        _compare(getattr(kind, half), own)
    return kind


def _import_class(name: TypeName) -> Any:
    try:
        module = import_module(f"{name.package}.{name.kind}")
        whole, is_part, _ = name.name.partition("_")
        if name.kind == "action" and is_part:  # the package exports only the whole action
            module = import_module(getattr(module, whole).__module__)
        return getattr(module, name.name)
    except (AttributeError, ImportError) as error:
        hint = (
            "build its package and source the workspace, set source to the ROS that runs here, or use the backend dds, "
            "which needs no built package"
        )
        raise ValueError(f"{name} is not installed in this ROS: {error}\n  hint: {hint}") from None


def _compare(kind: Any, definition: Message) -> None:
    theirs = {name: type_ for name, type_ in kind.get_fields_and_field_types().items() if name != FILLER}
    ours = {field.name: _type_text(field) for field in definition.fields}
    if list(theirs.items()) != list(ours.items()):
        pairs = [f"{type_} {name}" for name, type_ in theirs.items()]
        expected = [f"{type_} {name}" for name, type_ in ours.items()]
        raise ValueError(
            f"{definition.name} of this ROS has the fields {', '.join(pairs)}; shmgen expects {', '.join(expected)}\n"
            '  hint: set source = "..." in shmgen.toml to the ROS that runs here, generate, rebuild both sides'
        )


def _type_text(field: Field) -> str:
    """Return the type of a field in the notation of rosidl_generator_py, such as `sequence<double, 3>`."""
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
