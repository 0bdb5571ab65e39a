"""Parses YAML or JSON from a user into a message. Every error names the field."""

from __future__ import annotations

import json
import math
import time
from types import SimpleNamespace
from typing import Any

from shmgen.core.diagnostics import closest
from shmgen.runtime import Message, OutOfRange, Time
from shmgen.runtime.messages.numbers import boolean
from shmgen.runtime.messages.steps import CODES, Step
from shmgen.runtime.messages.times import CLOCKS
from shmgen.targets.python.names import python_member
from shmgen.tools.messages.format import ros_name

_FLOATS = {"NaN": float("nan"), "Infinity": float("inf"), "-Infinity": float("-inf")}
_CLOCK = ("sec", "nanosec")


def parse(text: str) -> Any:
    """Parse a JSON or YAML document.

    Raises ValueError with the invalid line, and OutOfRange if a number is too large for float64.
    """
    try:
        return _parse_text(text)
    except RecursionError:
        raise ValueError("brackets are nested too deeply") from None


def _parse_text(text: str) -> Any:
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
        raise ValueError(f"{text!r:.60} is not JSON, and YAML needs a package: run `pip install ruamel.yaml`") from None

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
        hint = "write YAML or JSON, in quotes: '{x: 1.0}'"
        raise ValueError(f"{place}{getattr(error, 'problem', None) or error}\n  hint: {hint}") from None


def _float(text: str) -> float:
    return _finite(float(text), text)


def _finite(value: float, text: str) -> float:
    """Return `value`, which was parsed from `text`. Raises OutOfRange if the number is too large for float64."""
    if math.isinf(value):
        raise OutOfRange("", f"{text} is too large for float64; write infinity as .inf")
    return value


def build(kind: type[Message], data: Any) -> Message:
    """Build a message from the values of `data`. Missing fields get the defaults of the definition.

    A time may be `now`. Raises OutOfRange, StringTooLong and CountExceeded with the path of the field.
    """
    return kind._from_object(_object(kind, {} if data is None else data, ""))


def _object(kind: type[Message], data: Any, path: str) -> SimpleNamespace:
    """Return an object with the attributes of a message, filled from `data`. The encoder checks the values later."""
    fields = _fields(data, [ros_name(name) for name in kind._names_], path, kind._type_name_)
    default = kind()
    values = SimpleNamespace(**{name: getattr(default, name) for name in kind._names_})
    steps = {step.name: step for step in kind._steps_}
    for name, value in fields.items():
        attribute, here = python_member(name), f"{path}.{name}" if path else name
        setattr(values, attribute, _value(steps[attribute], value, here))
    return values


def _value(step: Step, data: Any, path: str) -> Any:
    if not step.length:
        return _element(step.kind, data, path)
    if step.kind in CODES:
        return [_number(item) for item in data] if isinstance(data, list) else data
    if step.kind in CLOCKS or not isinstance(step.kind, str):
        return [_element(step.kind, item, f"{path}[{index}]") for index, item in enumerate(_list(data, path))]
    return data


def _element(kind: Any, data: Any, path: str) -> Any:
    if not isinstance(kind, str):
        return _object(kind, data, path)
    if kind in CLOCKS:
        return _clock(data, path)
    if kind == "bool":
        return boolean(data, path)
    return _number(data) if kind.startswith("float") else data


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
        hint = f"write `{{{known[0]}: ...}}`, with a blank after the colon" if known else "write `{}`"
        fields = ", ".join(known)
        raise OutOfRange(path, f"{data!r:.40} is {type(data).__name__}, not the fields of {owner}: {fields}; {hint}")
    for name in data:
        if name not in known:
            close = closest(str(name), known)
            hint = f"did you mean {close}?" if close else f"it has {', '.join(known) or 'no fields'}"
            raise OutOfRange(f"{path}.{name}" if path else str(name), f"no such field in {owner}; {hint}")
    return data
