"""Convert a layout's entries to C++ class members at the same offsets, and convert values to C++."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import (
    Array,
    Clock,
    Constant,
    Default,
    Element,
    Layout,
    Ref,
    Role,
    Scalar,
    Slot,
    String,
    TypeOptions,
    Value,
    assert_never,
    ros_type,
)
from shmgen.targets.c.names import c_member
from shmgen.targets.c.target import Member
from shmgen.targets.c.text import in_comment, quoted, quoted_wide
from shmgen.targets.counts import bound, counts
from shmgen.targets.cpp.names import class_name, qualified

_TYPES = {Scalar.BOOL: "::shmgen::Flag", Scalar.FLOAT32: "float", Scalar.FLOAT64: "double"}
_CLOCKS = {"TIME": "::shmgen::ClockMs", "LTIME": "::shmgen::ClockNs", "struct": "::shmgen::ClockPair"}
_CUT = {"utf-8": "cut_utf8", "latin-1": "cut_latin1"}


def members(layout: Layout, package: str) -> Iterator[Member]:
    """Yield the members in order. A sequence is one member, with its count and the padding before the elements."""
    counted = counts(layout)
    before: list[Slot] = []
    for slot in layout.slots:
        if slot.role is Role.COUNT or before:
            before.append(slot)
        if slot.role is Role.COUNT or (before and slot.role is not Role.DATA):
            continue
        start = before[0] if before else slot
        before = []
        element = element_of(slot.type, layout.options, package)
        is_packed = slot.align > layout.message.pack
        element = f"::shmgen::Unaligned<{element}>" if is_packed else element
        size = slot.offset + slot.size - start.offset
        comment = in_comment(_comment(slot))
        if slot.name in counted:
            gap = slot.offset - start.offset - 4
            most = bound(counted[slot.name])
            line = f"::shmgen::Sequence<{element}, {most}, {gap}, {class_name(layout.name)}>"
            aligned = ""
        else:
            line = element if slot.count is None else f"::std::array<{element}, {slot.count}>"
            is_aligned = slot.align > 1 and slot.role is Role.DATA and not is_packed
            aligned = f"alignas({slot.align}) " if is_aligned else ""
        declared = f"{aligned}{line} {c_member(slot.name)}{{{_initial(slot, layout.options)}}};"
        if slot.role is Role.PADDING:
            declared = f"::std::array<::std::uint8_t, {slot.size}> {c_member(slot.name)}{{}};"
        yield Member(declared, c_member(slot.name), str(start.offset), str(size), f"{start.offset}{comment}")


def visits(layout: Layout) -> str:
    """Return a C++ expression that calls the function `visit` for each field in order.

    The expression ends early, as false, if one of the calls returns false.
    """
    slots = [slot for slot in layout.slots if slot.role is Role.DATA]
    visited = (f"visit({quoted(slot.name.encode())}, message.{c_member(slot.name)})" for slot in slots)
    return "\n            && ".join(visited) or "true"


def element_of(type_: Element, options: TypeOptions, package: str) -> str:
    """Return the C++ type of one element."""
    match type_:
        case Scalar():
            return _TYPES.get(type_, f"::std::{type_.value}_t")
        case Clock():
            return _CLOCKS[options.time]
        case String(capacity, wide):
            kind = "WideText" if wide else "Text"
            cut = f", ::shmgen::Long::{_CUT[options.encoding]}" if options.overflow == "truncate" else ""
            return f"::shmgen::{kind}<{capacity}{cut}>"
        case Ref(name):
            return qualified(name, package)
        case _:
            assert_never(type_)


def constant_line(constant: Constant, options: TypeOptions) -> str:
    """Return the declaration of a constant as a static member with its value."""
    match constant.type:
        case String(_, wide):
            kind = "::std::u16string_view" if wide else "::std::string_view"
        case Scalar.BOOL:
            kind = "bool"
        case scalar:
            kind = _TYPES.get(scalar, f"::std::{scalar.value}_t")
    doc = in_comment(constant.doc.partition("\n")[0])
    comment = f" /* {doc} */" if doc else ""
    value = _value(constant.value, constant.type, options)
    return f"static constexpr {kind} {c_member(constant.name)} = {value};{comment}"


def _initial(slot: Slot, options: TypeOptions) -> str:
    """Return the default of a field as the C++ text between the braces of its declaration. `""` stands for zero."""
    default: Default | None = slot.field.default if slot.field and slot.role is Role.DATA else None
    if slot.field is None or default is None or isinstance(slot.type, (Ref, Clock)):
        return ""
    if not isinstance(default, tuple):
        return _value(default, slot.type, options)
    values = ", ".join(_value(value, slot.type, options) for value in default)
    return f"{{{values}}}" if isinstance(slot.field.type, Array) else values


def _value(value: Value, type_: Element, options: TypeOptions) -> str:
    match type_:
        case String(_, wide):
            return quoted_wide(str(value)) if wide else quoted(str(value).encode(options.encoding))
        case Scalar.BOOL:
            return "true" if value else "false"
        case Scalar.FLOAT32 | Scalar.FLOAT64:
            known = {"inf": "infinity()", "-inf": "infinity()", "nan": "quiet_NaN()"}
            kind = "float" if type_ is Scalar.FLOAT32 else "double"
            text = repr(float(value))
            if text in known:
                return f"{'-' if text[0] == '-' else ''}::std::numeric_limits<{kind}>::{known[text]}"
            return f"static_cast<float>({text})" if kind == "float" else text
        case _:
            number = int(value)
            suffix = "ULL" if number > 2**63 - 1 else "LL" if not -(2**31) < number < 2**31 else ""
            return f"{number}{suffix}" if number > -(2**63) else f"{number + 1}{suffix} - 1"


def _comment(slot: Slot) -> str:
    """Return a member's comment: ROS type, unit, and the first line of the field's comment."""
    if slot.role is Role.FILLER:
        return ": the message has no fields"
    if slot.field is None or slot.role is not Role.DATA:
        return ""
    unit = f" [{slot.field.unit}]" if slot.field.unit else ""
    doc = slot.field.doc.partition("\n")[0]
    return f": {ros_type(slot.field.type)}{unit}" + (f", {doc}" if doc else "")
