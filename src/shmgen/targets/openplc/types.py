"""Generate a message's structure for an open compiler, STruC++ or matiec.

The structure has no padding members. Its members have the defaults of the definition.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from shmgen.core.model import Layout, Layouts, Role, Scalar, Slot, String, TypeName
from shmgen.targets.openplc.blocks import Variable
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.openplc.names import member, whole
from shmgen.targets.st import names as st
from shmgen.targets.st.text import ascii_text, literal

SECONDS = (
    Variable("diSec", "DINT", "negative for a duration before zero"),
    Variable("udiNanosec", "UDINT", "0..999999999, always counted upwards"),
)
"""The members of ST_shmgen_Time."""


class Structure(NamedTuple):
    """A structure of Structured Text to generate. `doc` is its comment, one line."""

    name: str
    doc: str
    members: tuple[Variable, ...]


def ordered(layouts: Layouts) -> tuple[Layout, ...]:
    """Return the layouts sorted by name, except that a message comes after the messages that it contains."""
    by_name: dict[TypeName, Layout] = {}

    def put(name: TypeName) -> None:
        for inner in sorted(layouts[name].dependencies):
            put(inner)
        by_name.setdefault(name, layouts[name])

    for name in sorted(layouts):
        put(name)
    return tuple(by_name.values())


def structure(layout: Layout, compiler: Compiler) -> Structure:
    members = tuple(_member(slot, layout, compiler) for slot in layout.slots if slot.role is not Role.PADDING)
    return Structure(whole(st.st_type(layout.name)), str(layout.name), members)


def _member(slot: Slot, layout: Layout, compiler: Compiler) -> Variable:
    comment = ""
    if slot.role is Role.FILLER:
        comment = "the message has no fields"
    elif slot.role is Role.COUNT and slot.field:
        comment = f"number of valid elements in {member(slot.field.name)}"
    elif slot.field:
        comment = slot.field.doc.partition("\n")[0]
        if slot.field.unit and f"[{slot.field.unit}]" not in comment:
            comment = f"{comment} [{slot.field.unit}]".lstrip()
    value = _value(slot, layout)
    return Variable(member(slot.name), compiler.declared(slot, layout.options), ascii_text(comment), value)


def _value(slot: Slot, layout: Layout) -> str:
    """Return the initial value of a structure's member, from the default in the definition, as Structured Text.

    Return `""` if there is no default, if the field is a string, or if a compiler would reject the value. For strings,
    the generated program sets the defaults.
    """
    default = slot.field.default if slot.field else None
    if slot.role is Role.COUNT:
        return str(len(default)) if isinstance(default, tuple) and default else ""
    if slot.role is not Role.DATA or default in (None, ()) or not isinstance(slot.type, Scalar):
        return ""
    values = default if isinstance(default, tuple) else (default,)
    if any(isinstance(one, float) and not _is_small(one) for one in values):
        return ""
    spelled = [literal(one, slot.type, layout.options) for one in values]
    if any(one is None or " " in one for one in spelled):
        return ""
    return f"[{', '.join(filter(None, spelled))}]" if isinstance(default, tuple) else str(spelled[0])


def _is_small(value: float) -> bool:
    """Return True if both compilers accept a floating-point literal of this value.

    matiec converts each literal to a REAL of 32 bits, so a value outside the range of a REAL is not accepted.
    """
    return value == 0 or (math.isfinite(value) and 1e-37 < abs(value) < 1e38)


def constants(layout: Layout, compiler: Compiler) -> tuple[Variable, ...]:
    """Return the constants of a message as variables with initial values.

    Strings are omitted. Numbers are omitted if one of the compilers rejects their literals.
    """
    variables = []
    for constant in layout.message.constants:
        type_, value = constant.type, constant.value
        if isinstance(type_, String) or (isinstance(value, float) and not _is_small(value)):
            continue
        spelled = literal(value, type_, layout.options)
        if spelled and " " not in spelled:
            comment = ascii_text(constant.doc.partition("\n")[0])
            variables.append(Variable(member(constant.name), compiler.spelled(type_, layout.options), comment, spelled))
    return tuple(variables)
