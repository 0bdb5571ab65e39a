"""Turns layouts into Structured Text for CODESYS: a DUT, a list of constants and a pair of blocks for each message.

Services and actions get such a pair too (calls.py), and what shmgen.toml lists a block each and a program that calls
them (program.py). What is common to all is in common.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import (
    Clock,
    Layout,
    Layouts,
    Output,
    Role,
    Scalar,
    Slot,
    String,
    assert_never,
    text_length,
)
from shmgen.core.plural import counted
from shmgen.targets import Job
from shmgen.targets.st import calls, common, counts, names, program
from shmgen.targets.st.names import NAMES as NAMES
from shmgen.targets.st.objects import Attribute, DataType, Dut, GlobalList, Gvl, Head, Line, Variable, Variables
from shmgen.targets.st.text import MADE, WIDTH, ascii_text, comment_lines, literal, uncommented

_WIDEST_COLUMN = 56
"""Where comments begin at the latest; a longer declaration pushes only its own."""


class Block(NamedTuple):
    """A publisher or a subscriber, which `fits` checks for; the last three are names in `gvl`."""

    name: str
    title: str
    dut: str
    gvl: str
    fits: bool
    checks: tuple[counts.Check, ...]
    type_name: str = names.GVL_TYPE_NAME
    digest: str = names.GVL_DIGEST
    size: str = names.GVL_SIZE


def plan(job: Job, report: Report) -> Iterator[Output]:
    """`st/<package>/` one POU a file, `st/shmgen/`, and what calls the blocks."""
    layouts = job.layouts
    struct_time = any(layout.options.time == "struct" for layout in layouts.values())
    yield from common.plan(locks=job.options.regions.sync == "lock", struct_time=struct_time)
    only_called = calls.parts(layouts) - {topic.type for topic in job.topics}
    for layout in layouts.values():
        yield from _message(layout)
        if layout.requested and layout.name not in only_called:
            yield from _pair(layout, layouts)
    yield from calls.plan(layouts)
    yield from program.plan(job.topics, job.services, job.actions)


def _message(layout: Layout) -> Iterator[Output]:
    folder = f"st/{layout.name.package}"
    dut, gvl = _dut(layout), _gvl(layout)
    template = "enum" if dut.object.base else "alias" if dut.object.alias else "dut"
    yield Output(f"{folder}/{dut.object.name}.st", f"st/{template}.st.j2", dut)
    yield Output(f"{folder}/{gvl.object.name}.st", "st/gvl.st.j2", gvl)


def _dut(layout: Layout) -> Dut:
    doc = tuple(_doc(layout))
    if layout.options.own and " : " in layout.message.plc and (imported := _imported(layout, doc)):
        return imported
    members = [_member(slot, layout) for slot in layout.slots]
    head = Head(uncommented(doc), (Attribute("pack_mode", "1"),))
    stored = DataType(names.st_type(layout.name, layout.options), head, tuple(member.variable for member in members))
    return Dut(stored, doc, _aligned(members))


def _imported(layout: Layout, doc: tuple[str, ...]) -> Dut | None:
    """An enumeration or an alias of a PLC project, which is a message with the one field `value` to ROS."""
    (slot, *others), options = layout.slots, layout.options
    name, _, kind = layout.message.plc.partition(" : ")
    if others or name != names.st_type(layout.name, options) or slot.field is None:
        return None
    head = Head(uncommented(doc))
    if kind == "alias":
        _, own = names.own_member(slot.field.plc, options)
        return Dut(DataType(name, head, (), alias=own or names.iec_type(slot, options)), doc, ())
    if kind not in _COUNTING or not layout.message.constants:
        return None
    members = [
        _declaration(names.own_member(it.plc, options)[0] or names.st_member(it.name), "", str(it.value), it.doc)
        for it in layout.message.constants
    ]
    stored = DataType(name, head, tuple(it.variable for it in members), kind)
    commas = [*("," for _ in members[1:]), ""]
    lines = tuple(
        Line(f"{it.name} := {it.value}{comma}", tuple(it.comment)) for it, comma in zip(members, commas, strict=True)
    )
    return Dut(stored, doc, lines)


_COUNTING = frozenset({"BYTE", "WORD", "DWORD", "LWORD", *(it.iec for it in Scalar if it.range)})
"""What an enumeration can be over."""


def _gvl(layout: Layout) -> Gvl:
    name = names.gvl(layout.name)
    generated, (constants, remarks) = _generated(layout), _constants(layout)
    doc = (f"// {name}: constants of {layout.name}", MADE)
    variables = Variables("VAR_GLOBAL", True, tuple(one.variable for one in (*generated, *constants)))
    lines = (*_aligned(constants), *remarks)
    stored = GlobalList(name, Head(uncommented(doc), (Attribute("qualified_only"),)), variables)
    return Gvl(stored, doc, _aligned(generated), lines)


def _pair(layout: Layout, layouts: Layouts) -> Iterator[Output]:
    name = layout.name
    checks = counts.checks(layout, layouts, "Fits", "_pMsg^")
    for block, template in ((names.publisher_block(name), "publisher"), (names.subscriber_block(name), "subscriber")):
        view = Block(block, str(name), names.st_type(name, layout.options), names.gvl(name), bool(checks), checks)
        yield Output(f"st/{name.package}/{block}.st", f"st/{template}.st.j2", view)


def _doc(layout: Layout) -> Iterator[str]:
    yield f"// {layout.name}: {counted(layout.size, 'byte')}, layout digest 16#{layout.digest:016X}"
    origin = ascii_text(layout.message.origin)
    yield f"// Generated by shmgen (0BSD: use it freely) from {origin}; do not edit."
    if layout.message.doc:
        yield "//"
        yield from comment_lines(layout.message.doc)


class _Declaration(NamedTuple):
    """`name : type := value;` with its comment lines, before it is lined up with its neighbours.

    A value of several is that of an array, `[1, 2]`.
    """

    name: str
    type: str
    value: str | tuple[str, ...] | None
    comment: list[str]

    def code(self, name_width: int) -> str:
        value = f"[{', '.join(self.value)}]" if isinstance(self.value, tuple) else self.value
        return f"{self.name:<{name_width}} : {self.type}{'' if value is None else f' := {value}'};"

    @property
    def variable(self) -> Variable:
        return Variable(self.name, self.type, self.value or "", "\n".join(uncommented(self.comment)))


def _declaration(name: str, type_: str, value: str | tuple[str, ...] | None = None, comment: str = "") -> _Declaration:
    return _Declaration(name, type_, value, comment_lines(comment))


def _aligned(declarations: Sequence[_Declaration]) -> tuple[Line, ...]:
    """Colons and short comments in columns; a comment of several lines, or too long a one, goes above."""
    name_width = max((len(declaration.name) for declaration in declarations), default=0)
    rows = [(declaration.code(name_width), declaration.comment) for declaration in declarations]
    fitting = [code for code, lines in rows if _fits(code, lines)]
    column = max((len(code) for code in fitting if len(code) <= _WIDEST_COLUMN), default=0)
    return tuple(
        Line(f"{code:<{column}}  {lines[0]}") if _fits(code, lines) else Line(code, tuple(lines))
        for code, lines in rows
    )


def _fits(code: str, lines: list[str]) -> bool:
    return len(lines) == 1 and max(len(code), _WIDEST_COLUMN) + len(lines[0]) <= WIDTH


# --- DUT ----------------------------------------------------------------------------------------------


def _member(slot: Slot, layout: Layout) -> _Declaration:
    own, own_type = names.own_member(slot.field.plc if slot.field and slot.role is Role.DATA else "", layout.options)
    name, type_ = own or names.st_member(slot.name), own_type or names.iec_type(slot, layout.options)
    match slot.role:
        case Role.PADDING:
            return _declaration(name, type_)
        case Role.FILLER:
            return _declaration(name, type_, comment="the message has no fields")
        case Role.COUNT:
            assert slot.field is not None
            default = slot.field.default
            count = str(len(default)) if isinstance(default, tuple) and default else None
            return _declaration(name, type_, count, f"how many of {names.st_member(slot.field.name)} are valid")
        case Role.DATA:
            value = _initial(slot, layout)
            return _declaration(name, type_, value, _comment(slot, layout, value is None))
        case _:
            assert_never(slot.role)


def _initial(slot: Slot, layout: Layout) -> str | tuple[str, ...] | None:
    """None where the definition has no default, or Structured Text no literal for it."""
    assert slot.field is not None
    default = slot.field.default
    if default is None or default == () or not isinstance(slot.type, Scalar | String):
        return None
    if not isinstance(default, tuple):
        return literal(default, slot.type, layout.options)
    values = [literal(value, slot.type, layout.options) for value in default]
    return None if None in values else tuple(filter(None, values))


def _comment(slot: Slot, layout: Layout, without_value: bool) -> str:
    """The comment of the definition, the unit unless it stands there, and a default that no initialiser gives."""
    field = slot.field
    assert field is not None
    parts = [field.doc] if field.doc else []
    if field.unit and f"[{field.unit}]" not in field.doc:
        parts.append(f"[{field.unit}]")
    lines = [" ".join(parts)] if parts else []
    if isinstance(slot.type, Clock) and layout.options.time == "TIME":
        lines.append("ms, those of the ROS time modulo 2**32" if slot.type is Clock.TIME else "ms")
    default = field.default
    if without_value and default:
        lines.append(f"default: {list(default) if isinstance(default, tuple) else default}")
    return "\n".join(lines)


# --- Constants ----------------------------------------------------------------------------------------


def _generated(layout: Layout) -> tuple[_Declaration, ...]:
    name = str(layout.name)
    return (
        _declaration(names.GVL_TYPE_NAME, f"STRING({len(name)})", f"'{name}'"),
        _declaration(names.GVL_SIZE, "UDINT", str(layout.size), "bytes of one message"),
        _declaration(names.GVL_DIGEST, "LWORD", f"16#{layout.digest:016X}", "of the layout"),
    )


def _constants(layout: Layout) -> tuple[list[_Declaration], list[Line]]:
    """And, as comments, what has no literal (an infinity)."""
    remarks: list[Line] = []
    declarations = []
    for constant in layout.message.constants:
        type_ = constant.type
        if isinstance(type_, String):
            length = text_length(str(constant.value), type_, layout.options.encoding)
            type_ = String(max(1, length), type_.wide)  # STRING(0) is none
        value = literal(constant.value, type_, layout.options)
        name = names.st_member(constant.name)
        if value is None:
            remarks.append(Line(f"// {name} = {ascii_text(str(constant.value))} has no literal in Structured Text"))
        else:
            spelled = names.iec_element(type_, layout.options)
            declarations.append(_declaration(name, spelled, value, constant.doc))
    return declarations, remarks
