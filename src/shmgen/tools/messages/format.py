"""Formats a message as YAML like `ros2 topic echo`, or as a line of JSON."""

from __future__ import annotations

import ctypes
import json
import math
import re
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

from shmgen.core.escape import escaped
from shmgen.runtime import CountExceeded, Message
from shmgen.targets.python.names import python_member

SHORT = 32
"""Default number of array elements to print."""


def as_json(value: Any) -> str:
    """Return a message, or a value inside a message, as one line of JSON.

    NaN and infinity become "NaN", "Infinity" and "-Infinity".

    Raises CountExceeded if the count of a sequence is damaged.
    """
    return as_line(spelled(tree_of(value, None)))


def yaml(value: Any, most: int | None = SHORT) -> str:
    """Return a message, or a value inside a message, as YAML 1.2.

    Cut arrays after `most` elements and append the full length. Raises CountExceeded if the count of a sequence is
    damaged.
    """
    tree = tree_of(value, most)
    if isinstance(tree, dict):
        return "".join(f"{line}\n" for line in _lines(tree)) or "{}\n"
    lines = list(_lines({"": tree}))
    return "".join(f"{line.removeprefix(': ')}\n" for line in (lines[1:] or lines))


def as_line(value: Any, indent: int | None = None) -> str:
    """Return a value as JSON, by default on one line. Escape control characters: a terminal would obey them."""
    lines = json.dumps(value, ensure_ascii=False, indent=indent).split("\n")
    return "\n".join(line if line.isprintable() else "".join(map(_in_json, line)) for line in lines)


def ros_name(attribute: str) -> str:
    """Return the ROS name of an attribute of a generated class: `from_` -> `from`."""
    bare = attribute.removesuffix("_")
    return bare if python_member(bare) == attribute else attribute


def tree_of(value: Any, most: int | None) -> Any:
    """Convert a value to nested dicts, lists and scalars. Cut arrays after `most` elements; None keeps all elements.

    Raises CountExceeded if the count of a sequence is damaged.
    """
    match value:
        case Message():
            return {ros_name(name): _part(field(value, name), most, ros_name(name)) for name in value._names_}
        case tuple() if hasattr(value, "_asdict"):
            return value._asdict()
        case ctypes.Array() | list() | tuple():
            items = [_part(item, most, f"[{index}]") for index, item in enumerate(elements(value, most))]
            return items if most is None or len(value) <= most else [*items, f"... {len(value)} in all"]
        case _:
            return value


def field(message: Message, name: str) -> Any:
    """Return the value of the field `name` for printing. Shorten a float32 as shortest() does."""
    value = getattr(message, name)
    return shortest(value) if name in _float32_fields(type(message)) else value


def elements(values: Any, most: int | None = None) -> Sequence[Any]:
    """Return the first `most` elements of an array for printing. Shorten a float32 as shortest() does."""
    few: Sequence[Any] = values[:most]
    return [shortest(value) for value in few] if _is_float32(values) else few


def element(values: Any, index: int) -> Any:
    """Return one element of an array for printing. Shorten a float32 as shortest() does."""
    return shortest(values[index]) if _is_float32(values) else values[index]


def _is_float32(values: Any) -> bool:
    return getattr(values, "_type_", None) is ctypes.c_float


def shortest(value: float) -> float:
    """Return the decimal number with the fewest digits that is the same float32.

    For example, 0.009999999776482582 becomes 0.01.
    """
    near = (float(f"{value:.{digits}g}") for digits in range(1, 10))
    return next((number for number in near if ctypes.c_float(number).value == value), value)


@cache
def _float32_fields(kind: type[Message]) -> frozenset[str]:
    return frozenset(name for name, type_, *_ in getattr(kind, "_fields_", ()) if type_ is ctypes.c_float)


def _part(value: Any, most: int | None, name: str) -> Any:
    try:
        return tree_of(value, most)
    except CountExceeded as error:
        raise error.inside(name) from None


def _lines(tree: dict[str, Any]) -> Iterator[str]:
    for name, value in tree.items():
        match value:
            case dict() if value:
                yield f"{name}:"
                yield from (f"  {line}" for line in _lines(value))
            case list() if any(isinstance(item, dict) for item in value):
                yield f"{name}:"
                for item in value:
                    first, *rest = list(_lines(item)) if isinstance(item, dict) and item else [_flow(item)]
                    yield f"- {first}"
                    yield from (f"  {line}" for line in rest)
            case _:
                yield f"{name}: {_flow(value)}"


def _flow(value: Any) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case float() if not math.isfinite(value):
            return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
        case str():
            return _text(value)
        case list():
            return f"[{', '.join(map(_flow, value))}]"
        case dict():
            return "{}"
        case _:
            return repr(value)


_PLAIN = re.compile(r"[A-Za-z_/]([\w /.-]*[\w/.-])?", re.ASCII)
_WORDS = {"true", "false", "yes", "no", "on", "off", "y", "n", "null"}
"""Words that YAML 1.1 or 1.2 do not read as text."""
_SHORT = {"\n": "\\n", "\r": "\\r", "\t": "\\t", "\b": "\\b", "\f": "\\f"}


def _text(value: str) -> str:
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    if value.isprintable():
        return "'" + value.replace("'", "''") + "'"
    return f'"{"".join(map(_escaped, value))}"'


def _escaped(sign: str) -> str:
    return f"\\{sign}" if sign in '"\\' else _SHORT.get(sign) or escaped(sign)


def _in_json(sign: str) -> str:
    return sign if sign.isprintable() else json.dumps(sign)[1:-1]


def spelled(tree: Any) -> Any:
    """Replace NaN and infinity in nested dicts and lists by words, because JSON has no such numbers."""
    match tree:
        case dict():
            return {name: spelled(value) for name, value in tree.items()}
        case list():
            return [spelled(value) for value in tree]
        case float() if not math.isfinite(tree):
            return "NaN" if math.isnan(tree) else "Infinity" if tree > 0 else "-Infinity"
        case _:
            return tree
