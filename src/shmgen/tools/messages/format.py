"""A message as YAML as `ros2 topic echo` prints it, or as a line of JSON."""

from __future__ import annotations

import ctypes
import json
import math
import re
from collections.abc import Iterator
from typing import Any

from shmgen.core.escape import escaped
from shmgen.runtime import CountExceeded, Message
from shmgen.targets.python.names import python_member

SHORT = 32
"""So many elements of an array are shown unless all are asked for."""


def yaml(message: Message, most: int | None = SHORT) -> str:
    """YAML 1.2; of each array the first `most` elements, then how many there are in all. Raises CountExceeded."""
    tree = tree_of(message, most)
    return "".join(f"{line}\n" for line in _lines(tree)) if tree else "{}\n"


def as_json(message: Message, most: int | None = None) -> str:
    """One line, numbers that JSON does not know as "NaN", "Infinity" and "-Infinity". Raises CountExceeded."""
    return as_line(spelled(tree_of(message, most)))


def value_as_yaml(value: Any, most: int | None = SHORT) -> str:
    """The same of what is found within a message, by its path."""
    tree = tree_of(value, most)
    if isinstance(tree, dict):
        return "".join(f"{line}\n" for line in _lines(tree)) or "{}\n"
    lines = list(_lines({"": tree}))
    return "".join(f"{line.removeprefix(': ')}\n" for line in (lines[1:] or lines))


def as_line(value: Any, indent: int | None = None) -> str:
    """JSON that a terminal shows and does not obey: what is not printable is written by its number."""
    lines = json.dumps(value, ensure_ascii=False, indent=indent).split("\n")
    return "\n".join(line if line.isprintable() else "".join(map(_in_json, line)) for line in lines)


def ros_name(attribute: str) -> str:
    """The field that a generated class shows under that name: `from_` is `from`."""
    bare = attribute.removesuffix("_")
    return bare if python_member(bare) == attribute else attribute


def tree_of(value: Any, most: int | None) -> Any:
    """Nested dicts, lists and scalars. Raises CountExceeded."""
    match value:
        case Message():
            return {ros_name(name): _part(getattr(value, name), most, ros_name(name)) for name in value._names_}
        case tuple() if hasattr(value, "_asdict"):
            return value._asdict()
        case ctypes.Array() | list() | tuple():
            items = [_part(item, most, f"[{index}]") for index, item in enumerate(value[:most])]
            return items if most is None or len(value) <= most else [*items, f"... {len(value)} in all"]
        case _:
            return value


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
"""What YAML 1.1 or 1.2 take for something else than text."""
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
    """The same with words for the numbers that JSON does not know."""
    match tree:
        case dict():
            return {name: spelled(value) for name, value in tree.items()}
        case list():
            return [spelled(value) for value in tree]
        case float() if not math.isfinite(tree):
            return "NaN" if math.isnan(tree) else "Infinity" if tree > 0 else "-Infinity"
        case _:
            return tree
