"""Turns a type as it is spelled in a definition, `string<=10[<=5]`, into a FieldType."""

from __future__ import annotations

import re

from shmgen.core.model import Array, Clock, Element, FieldType, Ref, Scalar, Sequence, String, TypeName
from shmgen.definitions.tokens import Dialect, Token, shown

LARGEST_BOUND = 2**32 - 1
"""A count travels as UDINT."""


def read_type(written: Token, package: str, dialect: Dialect) -> FieldType:
    """A bare name is taken from `package`. Raises Wrong: SHM003, SHM102 or SHM302."""
    spelled = _SPELLED.fullmatch(written.text)
    if spelled is None:
        hint = "an array has one dimension: write `T[N]`, `T[<=N]` or `T[]`" if "[" in written.text else ""
        if written.text.count("[") > written.text.count("]"):
            hint = "a type is one word, without blanks: `T[N]`, `T[<=N]` or `T[]`"
        raise written.wrong("SHM003", f"{shown(written.text)} is not a type", hint)
    if dialect == "ros1" and "<=" in written.text:
        raise written.wrong("SHM102", "ROS 1 has no bounds", "write it without `<=`, and set it under [bounds]")
    element = _element(written, spelled["base"], package, dialect)
    if spelled["capacity"] is not None:
        capacity = read_bound(written.part(*spelled.span("capacity")), "SHM102")
        if not isinstance(element, String):
            raise written.wrong("SHM102", f"{shown(spelled['base'])} has no length; only strings are bounded so")
        element = String(capacity, element.wide)
    if spelled["length"] is None:
        return element
    if spelled["length"] == "" and not spelled["bounded"]:
        return Sequence(element)
    length = read_bound(written.part(*spelled.span("length")), "SHM102" if spelled["bounded"] else "SHM302")
    return Sequence(element, length) if spelled["bounded"] else Array(element, length)


def type_word(written: str) -> str:
    """`string` of `string<=10[<=5]`."""
    return re.split(r"<=|\[", written, maxsplit=1)[0]


def read_bound(number: Token, if_zero: str) -> int:
    """1 to LARGEST_BOUND. Raises Wrong: SHM102, for a zero `if_zero`."""
    if not re.fullmatch(r"[+-]?[0-9]+", number.text):
        hint = "" if number.text else "a type is one word, without blanks: `string<=10`, `T[<=10]`"
        raise number.wrong("SHM102", f"the bound {shown(number.text)} is not a whole number", hint)
    value = int(number.text) if len(number.text) <= 20 else LARGEST_BOUND + 1
    if value == 0:
        raise number.wrong(if_zero, "zero elements leave nothing to share", "give at least 1, or leave the field out")
    if not 1 <= value <= LARGEST_BOUND:
        raise number.wrong("SHM102", f"the bound {shown(number.text)} is not in 1..{LARGEST_BOUND}")
    return value


_SPELLED = re.compile(r"(?P<base>[^\[\]<=]+)(?:<=(?P<capacity>[^\[\]]*))?(?:\[(?P<bounded><=)?(?P<length>[^\[\]]*)\])?")
_REFERENCE = re.compile(r"(?:(?P<package>[A-Za-z][A-Za-z0-9_]*)/(?:msg/)?)?(?P<name>[A-Za-z][A-Za-z0-9_]*)")

# byte and char: rosidl_adapter takes both for uint8; genmsg takes byte for int8, char for uint8.
_ROS2: dict[str, Element] = {
    **{scalar.value: scalar for scalar in Scalar},
    "byte": Scalar.UINT8,
    "char": Scalar.UINT8,
    "string": String(),
    "wstring": String(wide=True),
    "time": Clock.TIME,
    "duration": Clock.DURATION,
}
_ROS1: dict[str, Element] = {name: type for name, type in _ROS2.items() if name != "wstring"} | {"byte": Scalar.INT8}
CLOCKS = {"Time": Clock.TIME, "Duration": Clock.DURATION}


def _element(written: Token, base: str, package: str, dialect: Dialect) -> Element:
    builtin = (_ROS1 if dialect == "ros1" else _ROS2).get(base)
    if builtin is not None:
        return builtin
    reference = _REFERENCE.fullmatch(base)
    if reference is None:
        raise written.wrong("SHM003", f"{shown(base)} is not a type", "a type is `int32`, `Name` or `package/Name`")
    name = reference["name"]
    if dialect == "ros1" and base == "Header":
        return Ref(TypeName("std_msgs", "msg", "Header"))
    owner = reference["package"] or package
    if owner == "builtin_interfaces" and name in CLOCKS:
        return CLOCKS[name]
    return Ref(TypeName(owner, "msg", name))
