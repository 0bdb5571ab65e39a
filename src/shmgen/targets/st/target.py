"""Turns layouts into Structured Text for CODESYS: a DUT, a list of constants and a pair of blocks for each message.

Services and actions get such a pair too (calls.py), and what shmgen.toml lists a block each and a program that calls
them (program.py). What is common to all is in common.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen.diagnostics import Report
from shmgen.model import (
    Action,
    Clock,
    Layout,
    Layouts,
    Output,
    Role,
    Scalar,
    Service,
    Slot,
    String,
    Topic,
    assert_never,
    text_length,
)
from shmgen.targets import naming
from shmgen.targets.st import calls, common, counts, program
from shmgen.targets.st.text import WIDTH, ascii_text, comment_lines, literal

_WIDEST_COLUMN = 56
"""Where comments begin at the latest; a longer declaration pushes only its own."""


class Line(NamedTuple):
    """A declaration with the comment beside it, and the comment lines that stand above it."""

    text: str
    above: tuple[str, ...] = ()


class Dut(NamedTuple):
    """A structure; `doc` are comment lines."""

    name: str
    doc: tuple[str, ...]
    members: tuple[Line, ...]


class Gvl(NamedTuple):
    """A list of constants, the generator's and the message's."""

    name: str
    title: str
    generated: tuple[Line, ...]
    has_constants: bool
    constants: tuple[Line, ...]


class Block(NamedTuple):
    """A publisher or a subscriber, which `fits` checks for; the last three are names in `gvl`."""

    name: str
    title: str
    dut: str
    gvl: str
    fits: bool
    checks: tuple[counts.Check, ...]
    type_name: str = naming.GVL_TYPE_NAME
    digest: str = naming.GVL_DIGEST
    size: str = naming.GVL_SIZE


def plan(
    layouts: Layouts,
    report: Report,
    topics: Sequence[Topic] = (),
    services: Sequence[Service] = (),
    actions: Sequence[Action] = (),
    *,
    locks: bool = True,
) -> Iterator[Output]:
    """`st/<package>/` one POU a file, `st/shmgen/`, and what calls the blocks. Reports SHM203 and SHM204."""
    struct_time = any(layout.options.time == "struct" for layout in layouts.values())
    yield from common.plan(locks=locks, struct_time=struct_time)
    type_of = lambda layout: [naming.st_type(layout.name)]  # noqa: E731
    naming.check_messages(layouts.values(), "type", type_of, naming.STRUCTURED_TEXT, report, [naming.ST_TIME])
    only_called = calls.parts(layouts) - {topic.type for topic in topics}
    for layout in layouts.values():
        naming.check_members(layout, naming.STRUCTURED_TEXT, report)
        own = tuple(declaration.name for declaration in _generated(layout))
        naming.check_constants(layout, naming.STRUCTURED_TEXT, own, report)
        yield from _message(layout)
        if layout.requested and layout.name not in only_called:
            yield from _pair(layout, layouts)
    yield from calls.plan(layouts)
    yield from program.plan(topics, services, actions, report)


def _message(layout: Layout) -> Iterator[Output]:
    name = layout.name
    folder = f"st/{name.package}"
    dut, gvl, title = naming.st_type(name), naming.gvl(name), str(name)
    yield Output(f"{folder}/{dut}.st", "st/dut.st.j2", Dut(dut, tuple(_doc(layout)), _members(layout)))
    generated, constants = _aligned(_generated(layout)), _constants(layout)
    yield Output(f"{folder}/{gvl}.st", "st/gvl.st.j2", Gvl(gvl, title, generated, bool(constants), constants))


def _pair(layout: Layout, layouts: Layouts) -> Iterator[Output]:
    name = layout.name
    checks = counts.checks(layout, layouts, "Fits", "_Received")
    for block, template in (
        (naming.publisher_block(name), "publisher"),
        (naming.subscriber_block(name), "subscriber"),
    ):
        view = Block(block, str(name), naming.st_type(name), naming.gvl(name), bool(checks), checks)
        yield Output(f"st/{name.package}/{block}.st", f"st/{template}.st.j2", view)


def _doc(layout: Layout) -> Iterator[str]:
    yield f"// {layout.name}: {layout.size} bytes, layout digest 16#{layout.digest:016X}"
    yield f"// Made by shmgen from {ascii_text(layout.message.origin)}; changes made here are lost."
    if layout.message.doc:
        yield "//"
        yield from comment_lines(layout.message.doc)


class _Declaration(NamedTuple):
    """`name : type := value;` with its comment, before it is lined up with its neighbours."""

    name: str
    type: str
    value: str | None = None
    comment: str = ""

    def code(self, name_width: int) -> str:
        value = "" if self.value is None else f" := {self.value}"
        return f"{self.name:<{name_width}} : {self.type}{value};"


def _aligned(declarations: Sequence[_Declaration]) -> tuple[Line, ...]:
    """Colons and short comments in columns; a comment of several lines, or too long a one, goes above."""
    name_width = max((len(declaration.name) for declaration in declarations), default=0)
    rows = [(declaration.code(name_width), comment_lines(declaration.comment)) for declaration in declarations]
    fitting = [code for code, lines in rows if _fits(code, lines)]
    column = max((len(code) for code in fitting if len(code) <= _WIDEST_COLUMN), default=0)
    return tuple(
        Line(f"{code:<{column}}  {lines[0]}") if _fits(code, lines) else Line(code, tuple(lines))
        for code, lines in rows
    )


def _fits(code: str, lines: list[str]) -> bool:
    return len(lines) == 1 and max(len(code), _WIDEST_COLUMN) + len(lines[0]) <= WIDTH


# --- DUT ----------------------------------------------------------------------------------------------


def _members(layout: Layout) -> tuple[Line, ...]:
    return _aligned([_member(slot, layout) for slot in layout.slots])


def _member(slot: Slot, layout: Layout) -> _Declaration:
    name, type_ = naming.st_member(slot.name), naming.iec_type(slot, layout.options)
    match slot.role:
        case Role.PADDING:
            return _Declaration(name, type_)
        case Role.FILLER:
            return _Declaration(name, type_, comment="the message has no fields")
        case Role.COUNT:
            assert slot.field is not None
            default = slot.field.default
            count = str(len(default)) if isinstance(default, tuple) and default else None
            return _Declaration(name, type_, count, f"how many of {naming.st_member(slot.field.name)} are valid")
        case Role.DATA:
            value = _initial(slot, layout)
            return _Declaration(name, type_, value, _comment(slot, layout, value is None))
        case _:
            assert_never(slot.role)


def _initial(slot: Slot, layout: Layout) -> str | None:
    """None where the definition has no default, or Structured Text no literal for it."""
    assert slot.field is not None
    default = slot.field.default
    if default is None or default == () or not isinstance(slot.type, Scalar | String):
        return None
    if not isinstance(default, tuple):
        return literal(default, slot.type, layout.options)
    values = [literal(value, slot.type, layout.options) for value in default]
    return None if None in values else f"[{', '.join(filter(None, values))}]"


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
        _Declaration(naming.GVL_TYPE_NAME, f"STRING({len(name)})", f"'{name}'"),
        _Declaration(naming.GVL_SIZE, "UDINT", str(layout.size), "bytes of one message"),
        _Declaration(naming.GVL_DIGEST, "LWORD", f"16#{layout.digest:016X}", "of the layout"),
    )


def _constants(layout: Layout) -> tuple[Line, ...]:
    """What has no literal (an infinity) stays as a comment at the end."""
    lines: list[Line] = []
    declarations = []
    for constant in layout.message.constants:
        type_ = constant.type
        if isinstance(type_, String):
            length = text_length(str(constant.value), type_, layout.options.encoding)
            type_ = String(max(1, length), type_.wide)  # STRING(0) is none
        value = literal(constant.value, type_, layout.options)
        name = naming.st_member(constant.name)
        if value is None:
            lines.append(Line(f"// {name} = {ascii_text(str(constant.value))} has no literal in Structured Text"))
        else:
            spelled = naming.iec_element(type_, layout.options)
            declarations.append(_Declaration(name, spelled, value, constant.doc))
    return (*_aligned(declarations), *lines)
