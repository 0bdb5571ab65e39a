"""Parse the type of a field in a definition, such as `string<=10[<=5]`, into a FieldType."""

from __future__ import annotations

import re

from shmgen.core.model import Array, Clock, Element, FieldType, Ref, Scalar, Sequence, String, TypeName
from shmgen.definitions.tokens import Dialect, Token, quote

LARGEST_BOUND = 2**32 - 1
"""The largest bound, because a count is stored as UDINT."""


def read_type(written: Token, package: str, dialect: Dialect) -> FieldType:
    """Parse a field's type into a FieldType. If the type names a message without a package, the package is `package`.

    Raises DefinitionError (SHM003, SHM102 or SHM302) if the type or a bound is invalid.
    """
    spelled = _SPELLED.fullmatch(written.text)
    if spelled is None:
        hint = "write `T[N]`, `T[<=N]` or `T[]`: an array has one dimension" if "[" in written.text else ""
        if written.text.count("[") > written.text.count("]"):
            hint = "write the type without blanks: `T[N]`, `T[<=N]` or `T[]`"
        raise written.error("SHM003", f"{quote(written.text)} is not a type", hint)
    if dialect == "ros1" and "<=" in written.text:
        raise written.error(
            "SHM102",
            "ROS 1 has no bounds",
            "remove `<=` and the number, and set the bound under [bounds] in shmgen.toml",
        )
    element = _element(written, spelled["base"], package, dialect)
    if spelled["capacity"] is not None:
        capacity = read_bound(written.part(*spelled.span("capacity")), "SHM102")
        if not isinstance(element, String):
            raise written.error(
                "SHM102", f"{quote(spelled['base'])} cannot have a bound; only strings and sequences can"
            )
        element = String(capacity, element.wide)
    if spelled["length"] is None:
        return element
    if spelled["length"] == "" and not spelled["bounded"]:
        return Sequence(element)
    length = read_bound(written.part(*spelled.span("length")), "SHM102" if spelled["bounded"] else "SHM302")
    return Sequence(element, length) if spelled["bounded"] else Array(element, length)


def type_word(written: str) -> str:
    """Return the type without bounds and brackets: `string` for `string<=10[<=5]`."""
    return re.split(r"<=|\[", written, maxsplit=1)[0]


def read_bound(number: Token, if_zero: str) -> int:
    """Parse a bound, a number from 1 to LARGEST_BOUND.

    Raises DefinitionError with the code `if_zero` if the bound is 0, and with SHM102 if the bound is invalid otherwise.
    """
    if not re.fullmatch(r"[+-]?[0-9]+", number.text):
        hint = "" if number.text else "write the type without blanks: `string<=10`, `T[<=10]`"
        raise number.error("SHM102", f"the bound {quote(number.text)} is not a whole number", hint)
    value = int(number.text) if len(number.text) <= 20 else LARGEST_BOUND + 1
    if value == 0:
        raise number.error(
            if_zero, "an array or bound of zero elements is not supported", "write at least 1, or remove the field"
        )
    if not 1 <= value <= LARGEST_BOUND:
        raise number.error("SHM102", f"the bound {quote(number.text)} is not in 1..{LARGEST_BOUND}")
    return value


_SPELLED = re.compile(r"(?P<base>[^\[\]<=]+)(?:<=(?P<capacity>[^\[\]]*))?(?:\[(?P<bounded><=)?(?P<length>[^\[\]]*)\])?")
_REFERENCE = re.compile(r"(?:(?P<package>[A-Za-z][A-Za-z0-9_]*)/(?:msg/)?)?(?P<name>[A-Za-z][A-Za-z0-9_]*)")

# rosidl_adapter reads byte and char as uint8; genmsg reads byte as int8 and char as uint8.
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
        raise written.error(
            "SHM003", f"{quote(base)} is not a type", "write a type as `int32`, `Name` or `package/Name`"
        )
    name = reference["name"]
    if dialect == "ros1" and base == "Header":
        return Ref(TypeName("std_msgs", "msg", "Header"))
    owner = reference["package"] or package
    if owner == "builtin_interfaces" and name in CLOCKS:
        return CLOCKS[name]
    return Ref(TypeName(owner, "msg", name))
