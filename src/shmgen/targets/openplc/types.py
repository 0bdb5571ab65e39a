"""Turns Layouts into the structures of an open dialect: members without gaps, with the definition's defaults."""

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
"""Of ST_shmgen_Time."""


class Structure(NamedTuple):
    """`doc` is one line."""

    name: str
    doc: str
    members: tuple[Variable, ...]


def ordered(layouts: Layouts) -> tuple[Layout, ...]:
    """By name, but for those that others hold, which come before."""
    found: dict[TypeName, Layout] = {}

    def put(name: TypeName) -> None:
        for inner in sorted(layouts[name].dependencies):
            put(inner)
        found.setdefault(name, layouts[name])

    for name in sorted(layouts):
        put(name)
    return tuple(found.values())


def structure(layout: Layout, compiler: Compiler) -> Structure:
    members = tuple(_member(slot, layout, compiler) for slot in layout.slots if slot.role is not Role.PADDING)
    return Structure(whole(st.st_type(layout.name)), str(layout.name), members)


def _member(slot: Slot, layout: Layout, compiler: Compiler) -> Variable:
    comment = ""
    if slot.role is Role.FILLER:
        comment = "the message has no fields"
    elif slot.role is Role.COUNT and slot.field:
        comment = f"how many of {member(slot.field.name)} are valid"
    elif slot.field:
        comment = slot.field.doc.partition("\n")[0]
        if slot.field.unit and f"[{slot.field.unit}]" not in comment:
            comment = f"{comment} [{slot.field.unit}]".lstrip()
    value = _value(slot, layout)
    return Variable(member(slot.name), compiler.declared(slot, layout.options), ascii_text(comment), value)


def _value(slot: Slot, layout: Layout) -> str:
    """The default; a text's is left to the program, and what no open compiler reads is none."""
    default = slot.field.default if slot.field else None
    if slot.role is Role.COUNT:
        return str(len(default)) if isinstance(default, tuple) and default else ""
    if slot.role is not Role.DATA or default in (None, ()) or not isinstance(slot.type, Scalar):
        return ""
    values = default if isinstance(default, tuple) else (default,)
    if isinstance(slot.type, String) or any(isinstance(one, float) and not _is_small(one) for one in values):
        return ""
    spelled = [literal(one, slot.type, layout.options) for one in values]
    if any(one is None or " " in one for one in spelled):
        return ""
    return f"[{', '.join(filter(None, spelled))}]" if isinstance(default, tuple) else str(spelled[0])


def _is_small(value: float) -> bool:
    """Whether both compilers read it: matiec makes a REAL of each literal."""
    return value == 0 or (math.isfinite(value) and 1e-37 < abs(value) < 1e38)


def constants(layout: Layout, compiler: Compiler) -> tuple[Variable, ...]:
    """As members that begin with the value. Texts, and numbers that have no literal there, are left out."""
    found = []
    for constant in layout.message.constants:
        type_, value = constant.type, constant.value
        if isinstance(type_, String) or (isinstance(value, float) and not _is_small(value)):
            continue
        spelled = literal(value, type_, layout.options)
        if spelled and " " not in spelled:
            comment = ascii_text(constant.doc.partition("\n")[0])
            found.append(Variable(member(constant.name), compiler.spelled(type_, layout.options), comment, spelled))
    return tuple(found)
