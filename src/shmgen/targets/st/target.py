"""Generate Structured Text for CODESYS: a DUT, a list of constants and a pair of blocks for each message.

Services and actions also get a pair of blocks (calls.py). Each topic, service and action of shmgen.toml gets a block,
and a program calls these blocks (program.py). The files that all messages share are in common.py.
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
from shmgen.targets.st.text import MADE, WIDTH, ascii_text, comment_lines, literal

_WIDEST_COLUMN = 56
"""The last column, in characters, where aligned comments begin. A longer declaration shifts only its own comment."""


class Block(NamedTuple):
    """The template data for a publisher or subscriber block. If `fits` is true, the block checks counts.

    `is_writer` is TRUE for a publisher, FALSE for a subscriber. `end` is the block's variable of type FB_ShmRegion.
    """

    name: str
    title: str
    dut: str
    gvl: str
    fits: bool
    checks: tuple[counts.Check, ...]
    is_writer: str
    end: str = "_fbRegion"


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield one file for each POU in `st/<package>/`, the shared files in `st/shmgen/`, and the program."""
    layouts = job.layouts
    struct_time = any(layout.options.time == "struct" for layout in layouts.values())
    yield from common.plan(locks=job.options.regions.sync == "lock", struct_time=struct_time)
    only_called = calls.parts(layouts) - {topic.type for topic in job.topics}
    for layout in layouts.values():
        yield from _message(layout)
        if layout.requested and layout.name not in only_called:
            yield from _pair(layout, layouts)
    yield from calls.plan(layouts)
    yield from program.plan(job)


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
    members = tuple(_member(slot, layout) for slot in layout.slots)
    head = Head(doc, (Attribute("pack_mode", "1"),))
    return Dut(DataType(names.st_type(layout.name, layout.options), head, members), _align(members))


def _imported(layout: Layout, doc: tuple[str, ...]) -> Dut | None:
    """Return the enumeration or alias from which `shmgen import` created this message, or None for other messages.

    ROS has neither enumerations nor aliases, so `shmgen import` writes a message with the single field `value`.
    """
    (slot, *others), options = layout.slots, layout.options
    name, _, kind = layout.message.plc.partition(" : ")
    if others or name != names.st_type(layout.name, options) or slot.field is None:
        return None
    head = Head(doc)
    if kind == "alias":
        _, own = names.own_member(slot.field.plc, options)
        return Dut(DataType(name, head, (), alias=own or names.iec_type(slot, options)), ())
    if kind not in _COUNTING or not layout.message.constants:
        return None
    members = tuple(
        _declaration(names.own_member(it.plc, options)[0] or names.st_member(it.name), "", str(it.value), it.doc)
        for it in layout.message.constants
    )
    commas = [*("," for _ in members[1:]), ""]
    lines = (Line(f"{it.name} := {it.value}{comma}", it.comment) for it, comma in zip(members, commas, strict=True))
    return Dut(DataType(name, head, members, kind), tuple(lines))


_COUNTING = frozenset({"BYTE", "WORD", "DWORD", "LWORD", *(it.iec for it in Scalar if it.range)})
"""The types that can be the base of an enumeration."""


def _gvl(layout: Layout) -> Gvl:
    name = names.gvl(layout.name)
    generated, (constants, remarks) = _type_constants(layout), _constants(layout)
    doc = (f"// {name}: constants of {layout.name}", MADE)
    variables = Variables("VAR_GLOBAL", True, (*generated, *constants))
    stored = GlobalList(name, Head(doc, (Attribute("qualified_only"),)), variables)
    return Gvl(stored, _align(generated), (*_align(constants), *remarks))


def _pair(layout: Layout, layouts: Layouts) -> Iterator[Output]:
    name = layout.name
    checks = counts.checks(layout, layouts, "Fits", "_pMsg^")
    for block, template, is_writer in (
        (names.block_name(name, "Publisher"), "publisher", "TRUE"),
        (names.block_name(name, "Subscriber"), "subscriber", "FALSE"),
    ):
        dut, gvl = names.st_type(name, layout.options), names.gvl(name)
        view = Block(block, str(name), dut, gvl, bool(checks), checks, is_writer)
        yield Output(f"st/{name.package}/{block}.st", f"st/{template}.st.j2", view)


def _doc(layout: Layout) -> Iterator[str]:
    yield f"// {layout.name}: {counted(layout.size, 'byte')}, layout digest 16#{layout.digest:016X}"
    origin = ascii_text(layout.message.origin)
    yield f"// Generated by shmgen (0BSD: use it freely) from {origin}; do not edit."
    if layout.message.doc:
        yield "//"
        yield from comment_lines(layout.message.doc)


def _declaration(name: str, type_: str, value: str | tuple[str, ...] = "", comment: str = "") -> Variable:
    return Variable(name, type_, value, tuple(comment_lines(comment)))


def _align(declarations: Sequence[Variable]) -> tuple[Line, ...]:
    """Return the lines of the declarations, with aligned colons and aligned short comments.

    A long comment stands above its declaration.
    """
    name_width = max((len(declaration.name) for declaration in declarations), default=0)
    rows = [(declaration.code(name_width), declaration.comment) for declaration in declarations]
    fitting = [code for code, lines in rows if _fits(code, lines)]
    column = max((len(code) for code in fitting if len(code) <= _WIDEST_COLUMN), default=0)
    return tuple(
        Line(f"{code:<{column}}  {lines[0]}") if _fits(code, lines) else Line(code, lines) for code, lines in rows
    )


def _fits(code: str, lines: tuple[str, ...]) -> bool:
    return len(lines) == 1 and max(len(code), _WIDEST_COLUMN) + len(lines[0]) <= WIDTH


# --- DUT ----------------------------------------------------------------------------------------------


def _member(slot: Slot, layout: Layout) -> Variable:
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
            count = str(len(default)) if isinstance(default, tuple) and default else ""
            return _declaration(name, type_, count, f"number of valid elements in {names.st_member(slot.field.name)}")
        case Role.DATA:
            value = _initial(slot, layout)
            return _declaration(name, type_, value, _comment(slot, layout, not value))
        case _:
            assert_never(slot.role)


def _initial(slot: Slot, layout: Layout) -> str | tuple[str, ...]:
    """Return a field's default as literals, or `""` if there is no default or a value has no literal."""
    assert slot.field is not None
    default = slot.field.default
    if default is None or default == () or not isinstance(slot.type, Scalar | String):
        return ""
    if not isinstance(default, tuple):
        return literal(default, slot.type, layout.options) or ""
    values = [literal(value, slot.type, layout.options) for value in default]
    return "" if None in values else tuple(filter(None, values))


def _comment(slot: Slot, layout: Layout, without_value: bool) -> str:
    """Return the comment of a member: the comment of the field and its unit. For a time, add the unit of its number.

    If `without_value` is true, the declaration has no initial value, so the comment contains the default.
    """
    field = slot.field
    assert field is not None
    parts = [field.doc] if field.doc else []
    if field.unit and f"[{field.unit}]" not in field.doc:
        parts.append(f"[{field.unit}]")
    lines = [" ".join(parts)] if parts else []
    if isinstance(slot.type, Clock) and layout.options.time == "TIME":
        lines.append("ROS time in ms since 1970, modulo 2**32" if slot.type is Clock.TIME else "ms")
    default = field.default
    if without_value and default:
        lines.append(f"default: {list(default) if isinstance(default, tuple) else default}")
    return "\n".join(lines)


# --- Constants ----------------------------------------------------------------------------------------


def _type_constants(layout: Layout) -> tuple[Variable, ...]:
    name = str(layout.name)
    return (
        _declaration(names.GVL_TYPE_NAME, f"STRING({len(name)})", f"'{name}'"),
        _declaration(names.GVL_SIZE, "UDINT", str(layout.size), "size of one message in bytes"),
        _declaration(names.GVL_DIGEST, "LWORD", f"16#{layout.digest:016X}", "layout digest"),
    )


def _constants(layout: Layout) -> tuple[list[Variable], list[Line]]:
    """Return the declarations of a message's constants, and a comment for each constant without a declaration.

    A constant such as an infinity gets no declaration, because Structured Text has no literal for its value.
    """
    remarks: list[Line] = []
    declarations = []
    for constant in layout.message.constants:
        type_ = constant.type
        if isinstance(type_, String):
            length = text_length(str(constant.value), type_, layout.options.encoding)
            type_ = String(max(1, length), type_.wide)  # STRING(0) does not exist
        value = literal(constant.value, type_, layout.options)
        name = names.st_member(constant.name)
        if value is None:
            remarks.append(Line(f"// {name} = {ascii_text(str(constant.value))} has no literal in Structured Text"))
        else:
            spelled = names.iec_element(type_, layout.options)
            declarations.append(_declaration(name, spelled, value, constant.doc))
    return declarations, remarks
