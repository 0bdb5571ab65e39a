"""Evaluates paths, such as `pose.position.x` and `points[2]`, and conditions on the fields of a message."""

from __future__ import annotations

import ast
import ctypes
import re
from collections.abc import Callable
from typing import Any

from shmgen.core.diagnostics import closest
from shmgen.runtime import Message
from shmgen.targets.python.names import python_member
from shmgen.tools.messages.format import element, field, ros_name

Getter = Callable[[Message], Any]

_STEP = re.compile(r"([A-Za-z_]\w*)((?:\[\d+\])*)", re.ASCII)
_INDEX = re.compile(r"\[(\d+)\]")


def getter(kind: type[Message], path: str) -> Getter:
    """Return a function that reads the value at `path` of a message.

    The function returns None if a sequence has no such element now. Raises ValueError with a suggestion if no message
    of this type can have the path.
    """
    steps: list[str | int] = []
    for part in path.split("."):
        match = _STEP.fullmatch(part)
        if match is None:
            raise ValueError(f"{path}: {part!r} is not a field; write pose.position.x, or points[2].x")
        steps += [match[1], *map(int, _INDEX.findall(match[2]))]
    _check(kind(), steps, path)

    def get(message: Message) -> Any:
        value: Any = message
        for step in steps:
            if isinstance(step, int):
                if step >= len(value):
                    return None
                value = element(value, step)
            else:
                member = python_member(step)
                value = field(value, member) if isinstance(value, Message) else getattr(value, member)
        return value

    return get


def _check(value: Any, steps: list[str | int], path: str) -> None:
    for step in steps:
        if isinstance(step, int):
            if not isinstance(value, (ctypes.Array, list, tuple)) or hasattr(value, "_fields"):
                raise ValueError(f"{path}: [{step}] is applied to a field that is not an array")
            if len(value) <= step:
                return  # a sequence, which is empty in a new message
            value = value[step]
        else:
            names = _names(value)
            if step not in names:
                close = closest(step, names)
                there = f"it has {', '.join(names)}" if names else "it has no fields"
                raise ValueError(f"{path}: no field {step}; {f'did you mean {close}?' if close else there}")
            value = getattr(value, python_member(step))


def _names(value: Any) -> list[str]:
    if isinstance(value, Message):
        return [ros_name(name) for name in value._names_]
    return list(getattr(value, "_fields", ())) if isinstance(value, tuple) else []


_ALLOWED = (
    *(ast.Expression, ast.BoolOp, ast.And, ast.Or, ast.UnaryOp, ast.Not, ast.USub, ast.BinOp, ast.Add, ast.Sub),
    *(ast.Mult, ast.Div, ast.Mod, ast.Compare, ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.In, ast.NotIn),
    *(ast.Attribute, ast.Subscript, ast.Name, ast.Constant, ast.Call, ast.Load, ast.Tuple, ast.List),
)
_FUNCTIONS = {"abs": abs, "len": len, "max": max, "min": min, "sum": sum, "any": any, "all": all}


def condition(kind: type[Message], text: str) -> Callable[[Message], bool]:
    """Return a function that evaluates a condition on a message, such as `position.x > 1 and name == "a"`.

    Fields may have the prefix `m.`, as in ROS 2. Only arithmetic, comparisons, fields, elements and a few functions are
    allowed, so that a condition has no side effects. If an element is missing, the condition is false. Raises
    ValueError if the condition is invalid.
    """
    try:
        tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError):
        raise ValueError(
            f"{text!r} is not a condition; write a condition such as position.x > 1 and name == 'a'"
        ) from None
    for node in ast.walk(tree):
        if not isinstance(node, _ALLOWED):
            raise ValueError(f"{text!r}: {type(node).__name__} is not allowed in a condition")
        name = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
        if name.startswith("_"):
            raise ValueError(f"{text!r}: {name} is not a field")
        if isinstance(node, ast.Call) and not (isinstance(node.func, ast.Name) and node.func.id in _FUNCTIONS):
            raise ValueError(f"{text!r}: the only functions are {', '.join(_FUNCTIONS)}")
        if isinstance(node, ast.Attribute):
            node.attr = python_member(node.attr)
    code = compile(tree, "condition", "eval")
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    members = {ros_name(name): name for name in kind._names_}
    if unknown := sorted(used - members.keys() - _FUNCTIONS.keys() - {"m"}):
        close = closest(unknown[0], members)
        there = f"it has {', '.join(members)}"
        raise ValueError(f"{text!r}: no field {unknown[0]}; {f'did you mean {close}?' if close else there}")

    def holds(message: Message) -> bool:
        names = _FUNCTIONS | {name: getattr(message, member) for name, member in members.items()} | {"m": message}
        try:
            return bool(eval(code, {"__builtins__": {}}, names))
        except (IndexError, ZeroDivisionError):
            return False
        except (AttributeError, TypeError) as error:
            raise ValueError(f"{text!r}: {error}") from None

    return holds
