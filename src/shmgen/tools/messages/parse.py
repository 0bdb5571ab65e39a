"""Reads what a person types, YAML or JSON, as a message; every complaint names the field."""

from __future__ import annotations

import json
import math
import time
from types import SimpleNamespace
from typing import Any

from shmgen.core.diagnostics import closest
from shmgen.runtime import Clock, Clocks, Elements, Message, OutOfRange, Time, values
from shmgen.targets.python.names import python_member
from shmgen.tools.messages.format import ros_name

_FLOATS = {"NaN": float("nan"), "Infinity": float("inf"), "-Infinity": float("-inf")}
_CLOCK = ("sec", "nanosec")


def parse(text: str) -> Any:
    """The value of a JSON document, or of a YAML one. Raises ValueError with the line at fault, and OutOfRange."""
    try:
        return _parsed(text)
    except RecursionError:
        raise ValueError("brackets are nested too deeply") from None


def _parsed(text: str) -> Any:
    try:
        return json.loads(text, parse_float=_float)
    except OutOfRange:
        raise
    except ValueError:
        pass
    try:
        from ruamel.yaml import YAML
        from ruamel.yaml.constructor import SafeConstructor
        from ruamel.yaml.error import YAMLError
    except ImportError:
        raise ValueError(f"{text!r:.60} is not JSON, and for YAML ruamel.yaml is missing: pip install it") from None

    class Constructor(SafeConstructor):
        def construct_float(self, node: Any) -> float:
            value: float = self.construct_yaml_float(node)
            return value if "inf" in node.value.lower() else _finite(value, node.value)

    Constructor.add_constructor("tag:yaml.org,2002:float", Constructor.construct_float)
    reader = YAML(typ="safe", pure=True)
    reader.Constructor = Constructor
    try:
        return reader.load(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise ValueError(f"{place}{getattr(error, 'problem', None) or error}; this is neither YAML nor JSON") from None


def _float(text: str) -> float:
    return _finite(float(text), text)


def _finite(value: float, text: str) -> float:
    """Infinity where nobody wrote it was a number too large for any float."""
    if math.isinf(value):
        raise OutOfRange("", f"{text} is too large for float64; infinity is written .inf")
    return value


def build(kind: type[Message], data: Any) -> Message:
    """A message with the values of `data`; where it is silent, the definition's defaults; a time may be `now`.

    Raises OutOfRange, StringTooLong and CountExceeded with the path of the field.
    """
    message = bytearray(kind())
    late: list[tuple[int, int, memoryview]] = []
    kind._encode(_object(kind, {} if data is None else data, ""), message, 0, late)
    for offset, room, array in late:
        message[offset : offset + room] = bytes(array).ljust(room, b"\0")
    return kind.from_buffer_copy(message)


def _object(kind: type[Message], data: Any, path: str) -> SimpleNamespace:
    """An object with the attributes of the message, for the encoder, which checks the values themselves."""
    fields = _fields(data, [ros_name(name) for name in kind._names_], path, kind._type_name_)
    default = kind()
    made = SimpleNamespace(**{name: getattr(default, name) for name in kind._names_})
    for name, value in fields.items():
        attribute = python_member(name)
        here = f"{path}.{name}" if path else name
        setattr(made, attribute, _value(kind.__dict__[attribute], getattr(default, attribute), value, here))
    return made


def _value(member: Any, default: Any, data: Any, path: str) -> Any:
    match member:
        case Elements() if issubclass(member.kind, Message):
            return [_object(member.kind, item, f"{path}[{index}]") for index, item in enumerate(_list(data, path))]
        case Elements() if isinstance(data, list):
            return [_number(item) for item in data]
        case Clocks():
            return [_clock(item, f"{path}[{index}]") for index, item in enumerate(_list(data, path))]
        case Clock():
            return _clock(data, path)
        case _ if isinstance(default, Message):
            return _object(type(default), data, path)
        case _ if isinstance(default, bool):
            return values.boolean(data, path)
        case _ if isinstance(default, float):
            return _number(data)
        case _:
            return data


def _clock(data: Any, path: str) -> Time:
    if data == "now":
        return Time(*divmod(time.time_ns(), 10**9))
    return Time(**_fields(data, _CLOCK, path, "a time"))


def _number(data: Any) -> Any:
    return _FLOATS.get(data, data) if isinstance(data, str) else data


def _list(data: Any, path: str) -> list[Any]:
    if not isinstance(data, list):
        raise OutOfRange(path, f"{data!r:.40} is {type(data).__name__}, not a sequence")
    return data


def _fields(data: Any, known: tuple[str, ...] | list[str], path: str, owner: str) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise OutOfRange(path, f"{data!r:.40} is {type(data).__name__}, not the fields of {owner}: {', '.join(known)}")
    for name in data:
        if name not in known:
            close = closest(str(name), known)
            hint = f"did you mean {close}?" if close else f"it has {', '.join(known) or 'no fields'}"
            raise OutOfRange(f"{path}.{name}" if path else str(name), f"no such field in {owner}; {hint}")
    return data
