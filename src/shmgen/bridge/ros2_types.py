"""Turns definitions into the installed classes of rosidl, and plain objects into messages of them and back.

The setters of those classes take no other class than their own, nor an int for a `byte`, which is bytes of length 1.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from rosidl_runtime_py.utilities import get_message, get_service

from shmgen.bridge.backend import ServiceWire
from shmgen.model import Array, Clock, Element, Field, FieldType, Message, Ref, Scalar, Sequence, String, TypeName
from shmgen.runtime import Duration, Time
from shmgen.targets.python.names import python_member

Convert = Callable[[Any], Any]


def message(messages: tuple[Message, ...]) -> Any:
    """The class of the last of `messages`. Raises ValueError if it is not installed, or of other fields."""
    name = messages[-1].name
    try:
        kind = get_message(str(name))
    except (AttributeError, ImportError, ValueError) as error:
        raise ValueError(
            f"{name} is not installed in this ROS: {error}\n  hint: build its package and source the workspace"
        ) from None
    _compare(kind, messages[-1])
    return kind


def service(wire: ServiceWire) -> Any:
    """The class of the service. Raises ValueError as message()."""
    try:
        kind = get_service(str(wire.type))
    except (AttributeError, ImportError, ValueError) as error:
        raise ValueError(
            f"{wire.type} is not installed in this ROS: {error}\n  hint: build its package and source the workspace"
        ) from None
    _compare(kind.Request, wire.request[-1])
    _compare(kind.Response, wire.response[-1])
    return kind


def blank(messages: tuple[Message, ...]) -> Callable[[], Any]:
    """What makes plain objects with the fields of the last of `messages`, all zero and empty."""
    known = {message.name: message for message in messages}

    def make(name: TypeName) -> Any:
        return SimpleNamespace(**{python_member(field.name): empty(field.type) for field in known[name].fields})

    def empty(type_: FieldType) -> Any:
        match type_:
            case Scalar():
                return False if type_ is Scalar.BOOL else 0.0 if type_.is_float else 0
            case String():
                return ""
            case Clock():
                return Time() if type_ is Clock.TIME else Duration()
            case Ref(name):
                return make(name)
            case Array(element, length):
                return [empty(element) for _ in range(length)]
            case Sequence():
                return []

    return lambda: make(messages[-1].name)


def to_ros(kind: Any, messages: tuple[Message, ...]) -> Convert:
    """What makes a message of the class `kind` from any object with the fields of the last of `messages`."""
    known = {message.name: message for message in messages}

    def convert(value: Any, made: Any, name: TypeName) -> Any:
        for field in known[name].fields:
            given = getattr(value, python_member(field.name))
            setattr(made, field.name, one_or_all(field, given, getattr(made, field.name)))
        return made

    def one_or_all(field: Field, given: Any, there: Any) -> Any:
        if isinstance(field.type, Array | Sequence):
            if _is_byte(field):
                return [bytes([item]) for item in given]
            if isinstance(field.type.element, Ref | Clock):
                return [element(field.type.element, item, _class(field.type.element)()) for item in given]
            return given
        return bytes([given]) if _is_byte(field) else element(field.type, given, there)

    def element(type_: Element, given: Any, there: Any) -> Any:
        match type_:
            case Ref(name):
                return convert(given, there, name)
            case Clock():
                there.sec, there.nanosec = given.sec, given.nanosec
                return there
            case _:
                return given

    return lambda value: convert(value, kind(), messages[-1].name)


def from_ros(messages: tuple[Message, ...]) -> Convert:
    """What makes a message of rosidl one with int for each `byte`; itself where there is none."""
    known = {message.name: message for message in messages}
    if not any(_is_byte(field) for message in messages for field in message.fields):
        return lambda value: value

    def convert(value: Any, name: TypeName) -> Any:
        return SimpleNamespace(
            **{python_member(field.name): one_or_all(field, getattr(value, field.name)) for field in known[name].fields}
        )

    def one_or_all(field: Field, given: Any) -> Any:
        if isinstance(field.type, Array | Sequence):
            if _is_byte(field):
                return [item[0] for item in given]
            return (
                [convert(item, field.type.element.name) for item in given]
                if isinstance(field.type.element, Ref)
                else given
            )
        if isinstance(field.type, Ref):
            return convert(given, field.type.name)
        return given[0] if _is_byte(field) else given

    return lambda value: convert(value, messages[-1].name)


def _compare(kind: Any, definition: Message) -> None:
    theirs, ours = list(kind.get_fields_and_field_types()), [field.name for field in definition.fields]
    if ours and theirs != ours:  # a message without fields has one that rosidl adds
        raise ValueError(
            f"{definition.name} of this ROS has the fields {', '.join(theirs)}, and not {', '.join(ours)}\n"
            '  hint: set source = "..." in shmgen.toml to the ROS that runs here, generate, rebuild both sides'
        )


def _class(type_: Ref | Clock) -> Any:
    if isinstance(type_, Ref):
        return get_message(str(type_.name))
    return get_message(f"builtin_interfaces/msg/{'Time' if type_ is Clock.TIME else 'Duration'}")


def _is_byte(field: Field) -> bool:
    return field.written.split("[")[0] == "byte"
