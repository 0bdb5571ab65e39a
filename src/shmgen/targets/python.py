"""Turns Layouts into the Python package of ctypes classes with their publishers and subscribers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Set
from dataclasses import dataclass
from itertools import groupby

from shmgen.diagnostics import Report
from shmgen.model import (
    Clock,
    Default,
    Element,
    Layout,
    Layouts,
    Output,
    Ref,
    Role,
    Scalar,
    Slot,
    String,
    TypeName,
    TypeOptions,
    assert_never,
    ros_type,
)
from shmgen.targets import python_codec as codec
from shmgen.targets.naming import PYTHON, check_constants, check_members, file_stem, python_member

CTYPES = {
    Scalar.BOOL: "c_bool",
    Scalar.INT8: "c_int8",
    Scalar.UINT8: "c_uint8",
    Scalar.INT16: "c_int16",
    Scalar.UINT16: "c_uint16",
    Scalar.INT32: "c_int32",
    Scalar.UINT32: "c_uint32",
    Scalar.INT64: "c_int64",
    Scalar.UINT64: "c_uint64",
    Scalar.FLOAT32: "c_float",
    Scalar.FLOAT64: "c_double",
}
_USED_IN_CLASS = codec.MODULES | {"bool", "bytearray", "bytes", "float", "int", "memoryview", "staticmethod", "str"}
_RUFF_WIDTH = 88
"""Characters; what ruff and black allow a line unless they are told otherwise."""
_CLOCK_CTYPES = {"TIME": "ctypes.c_uint32", "LTIME": "ctypes.c_uint64", "struct": "ctypes.c_uint32 * 2"}


@dataclass(frozen=True, slots=True)
class Row:
    """`name: type = value`, as much of it as the place that prints it needs."""

    name: str
    type: str = ""
    value: str = ""


@dataclass(frozen=True, slots=True)
class Module:
    """One message; all strings finished, `encode` and `decode` one statement line each."""

    title: str
    origin: str
    size: str
    digest: str
    digest_literal: str
    imports: tuple[str, ...]
    class_name: str
    structs: tuple[Row, ...]
    rows: tuple[Row, ...]
    summary: str
    doc: tuple[str, ...]
    fields: tuple[Row, ...]
    names: tuple[str, ...]
    constants: tuple[Row, ...]
    plain: tuple[Row, ...]
    shown: tuple[Row, ...]
    hiding: tuple[str, ...]
    encode: tuple[str, ...]
    decode: tuple[str, ...]
    defaults: tuple[str, ...]
    requested: bool


@dataclass(frozen=True, slots=True)
class Package:
    """An `__init__.py` that lifts the classes of its modules."""

    title: str
    imports: tuple[str, ...]
    names: tuple[str, ...]


def plan(layouts: Layouts, report: Report, package: str = "shm_msgs") -> Iterator[Output]:
    """`python/<package>/<ros package>/msg/_pose.py` for each message, and the packages above them."""
    root = f"python/{package}"
    yield Output(f"{root}/__init__.py", "python/package.py.j2", Package("Messages in shared memory", (), ()))
    yield Output(f"{root}/py.typed", "python/py.typed.j2", None)
    for ros_package in dict.fromkeys(name.package for name in sorted(layouts)):
        title = f"Messages of {ros_package} in shared memory"
        yield Output(f"{root}/{ros_package}/__init__.py", "python/package.py.j2", Package(title, (), ()))
    folder_of = lambda name: (name.package, name.kind)  # noqa: E731
    for (ros_package, kind), names in groupby(sorted(layouts), key=folder_of):
        folder = f"{root}/{ros_package}/{kind}"
        members = [layouts[name] for name in names]
        _check_classes(members, report)
        for layout in members:
            check_members(layout, PYTHON, report)
            check_constants(layout, PYTHON, (), report)
        yield Output(f"{folder}/__init__.py", "python/package.py.j2", _package(ros_package, kind, members))
        for layout in members:
            yield Output(f"{folder}/_{file_stem(layout.name)}.py", "python/message.py.j2", _module(layout, layouts))


def _package(ros_package: str, kind: str, layouts: list[Layout]) -> Package:
    modules = {f"._{file_stem(layout.name)}": _classes(layout) for layout in layouts}
    imports = tuple(line for module in sorted(modules, key=_sorted_by) for line in _import(module, modules[module]))
    names = sorted((name for names in modules.values() for name in names), key=_sorted_by)
    return Package(f"Messages of {ros_package}/{kind} in shared memory", imports, tuple(names))


def _classes(layout: Layout) -> list[str]:
    name = class_name(layout.name)
    return [name, f"{name}Publisher", f"{name}Subscriber"] if layout.requested else [name]


def class_name(name: TypeName) -> str:
    return python_member(name.name)


def _check_classes(layouts: list[Layout], report: Report) -> None:
    """A type called PosePublisher beside Pose, or two files equal up to case, would overwrite each other."""
    for what, names_of in (("class", _classes), ("file", lambda layout: [file_stem(layout.name)])):
        seen: dict[str, Layout] = {}
        for layout in layouts:
            for name in names_of(layout):
                if name in seen:
                    report.error(
                        "SHM203",
                        f"{layout.name.short} and {seen[name].name.short} both become the Python {what} {name}",
                        layout.message.span,
                        hint="rename one of the messages",
                    )
                seen.setdefault(name, layout)


def _module(layout: Layout, layouts: Layouts) -> Module:
    names = _imported_names(layout, layouts)
    made = codec.Codec(layouts, names)
    made.message(layout)
    structs = [f"_STRUCT{index if len(made.runs) > 1 else ''}" for index in range(len(made.runs))]
    message = layout.message
    data = [slot for slot in layout.slots if slot.role is Role.DATA]
    counts = {slot.name.removesuffix("_count"): slot.offset for slot in layout.slots if slot.role is Role.COUNT}
    shown = [slot for slot in data if _is_shown(slot)]
    plain = [slot for slot in data if not _is_shown(slot)]
    encode = tuple(_encode_lines(made, structs))
    fields = tuple(Row(_stored_name(slot), _ctype(slot, layout.options, names)) for slot in layout.slots)
    descriptors = [
        Row(python_member(slot.name), value=_descriptor(slot, layout.options, names, counts.get(slot.name)))
        for slot in shown
    ]
    annotations = [Row(python_member(slot.name), _annotation(slot.type, names)) for slot in plain]
    used = _USED_IN_CLASS | set(names.values())
    uses_ctypes = any("ctypes." in row.type + row.value for row in (*fields, *descriptors))
    return Module(
        title=str(layout.name),
        origin=_in_docstring(message.origin),
        size=f"{layout.size:,}",
        digest=f"{layout.digest:016x}",
        digest_literal=f"0x{layout.digest:016X}",
        imports=tuple(_imports(layout, names, bool(structs), uses_ctypes, bool(encode or shown))),
        class_name=class_name(layout.name),
        structs=tuple(Row(name, value=run.format) for name, run in zip(structs, made.runs, strict=True)),
        rows=tuple(Row(path, code) for path, code in made.rows),
        summary=_in_docstring(message.doc.partition("\n")[0]) or f"{layout.name.short}.",
        doc=tuple(_documentation(layout)),
        fields=fields,
        names=tuple(python_member(slot.name) for slot in data),
        constants=tuple(
            Row(python_member(c.name), type(c.value).__name__, _literal(c.value)) for c in message.constants
        ),
        plain=tuple(row for row in annotations if row.name not in used),
        shown=tuple(row for row in descriptors if row.name not in used),
        hiding=tuple(_hiding(annotations, descriptors, used)),
        encode=encode,
        decode=tuple(_decode_lines(made, structs)),
        defaults=tuple(_default_lines(layout, layouts)),
        requested=layout.requested,
    )


def _hiding(annotations: list[Row], descriptors: list[Row], used: Set[str]) -> Iterator[str]:
    """Fields named like something the class body uses: last, in one assignment, and `int` after what is one."""
    hidden = [row for row in descriptors if row.name in used]
    if hidden:
        yield f"{', '.join(row.name for row in hidden)} = {', '.join(row.value for row in hidden)}"
    annotated = [row for row in annotations if row.name in used]
    yield from (f"{row.name}: {row.type}" for row in sorted(annotated, key=lambda row: row.name in ("float", "int")))


def _imported_names(layout: Layout, layouts: Layouts) -> dict[TypeName, str]:
    """The bare class name, with its package before it where two would be the same."""
    taken = {class_name(layout.name)}
    names: dict[TypeName, str] = {}
    for name in dict.fromkeys((*layout.dependencies, *_array_elements(layout, layouts))):
        bare = class_name(name)
        names[name] = f"{name.package}_{bare}" if bare in taken else bare
        taken.add(names[name])
    return names


def _array_elements(layout: Layout, layouts: Layouts) -> Iterator[TypeName]:
    """Messages in arrays, those of nested messages too: their own classes encode them."""
    for slot in layout.slots:
        if isinstance(slot.type, Ref):
            if slot.count is None:
                yield from _array_elements(layouts[slot.type.name], layouts)
            else:
                yield slot.type.name


def _imports(layout: Layout, names: dict[TypeName, str], packs: bool, stores: bool, converts: bool) -> Iterator[str]:
    if stores:
        yield "import ctypes"
    if packs:
        yield "import struct"
    yield from ("import typing", "", "from shmgen import runtime")
    if converts:
        yield "from shmgen.runtime import values"
    modules = {}
    for name, imported in names.items():
        near = (name.package, name.kind) == (layout.name.package, layout.name.kind)
        module = f"._{file_stem(name)}" if near else f"...{name.package}.{name.kind}._{file_stem(name)}"
        bare = class_name(name)
        modules[module] = bare if bare == imported else f"{bare} as {imported}"
    if modules:
        yield ""
    for module in sorted(modules, key=lambda module: (not module.startswith("..."), _sorted_by(module))):
        yield from _import(module, [modules[module]])


def _import(module: str, names: list[str]) -> list[str]:
    line = f"from {module} import {', '.join(names)}"
    return [line] if len(line) <= _RUFF_WIDTH else [f"from {module} import (", *(f"    {name}," for name in names), ")"]


def _sorted_by(name: str) -> tuple[bool, bool, list[tuple[bool, int, str]]]:
    """As ruff sorts modules and `__all__`: constants, classes, the rest, and 8 before 16."""
    parts = [(part.isdigit(), int(part) if part.isdigit() else 0, part) for part in re.split(r"(\d+)", name) if part]
    return not name.isupper(), not name[0].isupper(), parts


def _is_shown(slot: Slot) -> bool:
    """Whether the class shows the member otherwise than ctypes does: arrays, text and times."""
    return slot.count is not None or not isinstance(slot.type, Scalar | Ref)


def _stored_name(slot: Slot) -> str:
    if slot.role is Role.DATA:
        return ("_" if _is_shown(slot) else "") + python_member(slot.name)
    return f"_{slot.name}"  # with two underscores for padding: `_pad0` may be how a string `pad0` is stored


def _ctype(slot: Slot, options: TypeOptions, names: dict[TypeName, str]) -> str:
    many = "" if slot.count is None else f" * {slot.count}"
    return _element_ctype(slot.type, options, names) + many


def _element_ctype(type_: Element, options: TypeOptions, names: dict[TypeName, str]) -> str:
    match type_:
        case Scalar():
            return f"ctypes.{CTYPES[type_]}"
        case Clock():
            return _CLOCK_CTYPES[options.time]
        case String(capacity, wide):
            return f"ctypes.{'c_uint16' if wide else 'c_char'} * {(capacity or 0) + 1}"
        case Ref(name):
            return names[name]
        case _:
            assert_never(type_)


def _annotation(type_: Element, names: dict[TypeName, str]) -> str:
    match type_:
        case Scalar():
            return "bool" if type_ is Scalar.BOOL else "float" if type_.is_float else "int"
        case Ref(name):
            return names[name]
        case Clock() | String():
            raise AssertionError("shown by a descriptor")
        case _:
            assert_never(type_)


def _descriptor(slot: Slot, options: TypeOptions, names: dict[TypeName, str], count_at: int | None) -> str:
    counted = "" if count_at is None else f", count_at={count_at}"
    match slot.type:
        case String(capacity, _):
            ways = f"{codec.text_in(slot.type, options)}, {codec.text_out(slot.type, options)}"
            if slot.count is None:
                return f"runtime.Text({slot.offset}, {slot.size}, {capacity}, {ways})"
            return f"runtime.Texts({slot.offset}, {slot.element_size}, {capacity}, {slot.count}, {ways}{counted})"
        case Clock():
            code = f'"{codec.CLOCK_CODES[options.time]}"'
            ways = f"{codec.clock_in(slot.type, options)}, {codec.clock_out(slot.type, options)}"
            if slot.count is None:
                return f"runtime.Clock({slot.offset}, {code}, {ways})"
            return f"runtime.Clocks({slot.offset}, {code}, {slot.count}, {ways}{counted})"
        case Scalar() | Ref():
            kind = _element_ctype(slot.type, options, names)
            return f"runtime.Elements({slot.offset}, {kind}, {slot.count}{counted})"
        case _:
            assert_never(slot.type)


def _documentation(layout: Layout) -> Iterator[str]:
    """The rest of the comment's first paragraph, the fields with shape, bound and unit, and the definition."""
    yield from _in_docstring(layout.message.doc).partition("\n\n")[0].split("\n")[1:]
    fields = layout.message.fields
    if fields:
        yield from ("", "Fields:")
    for field in fields:
        unit = f" [{field.unit}]" if field.unit else ""
        doc = _in_docstring(field.doc.partition("\n")[0])
        yield f"    {field.name} ({ros_type(field.type)}){unit}" + (f": {doc}" if doc else "")
    text = _in_docstring(layout.message.text).strip("\n")
    if text.strip():
        yield from ("", "Definition::", "")
        yield from (f"    {line}".rstrip() for line in text.split("\n"))


def _in_docstring(text: str) -> str:
    """Text that cannot end the docstring it stands in, nor begin an escape."""
    cleaned = "".join(char if char == "\n" or char.isprintable() else " " for char in text)
    return cleaned.replace("\\", "\\\\").replace('"', '\\"' if '"""' in cleaned or cleaned.endswith('"') else '"')


def _encode_lines(made: codec.Codec, structs: list[str]) -> Iterator[str]:
    yield from made.locals
    yield from made.before
    for name, run in zip(structs, made.runs, strict=True):
        yield from _exploded(f"{name}.pack_into(", ["into", codec.place(run.offset), *run.values], ")")
    yield from made.after


def _decode_lines(made: codec.Codec, structs: list[str]) -> Iterator[str]:
    yield from made.locals
    for name, run in zip(structs, made.runs, strict=True):
        end = f") = {name}.unpack_from(data, {codec.place(run.offset)})"
        if len(run.targets) == 1:
            yield f"({run.targets[0]},{end}"
        else:
            yield from _exploded("(", run.targets, end)
    yield from made.decoded


def _exploded(start: str, items: list[str], end: str) -> list[str]:
    return [start, *(f"    {item}," for item in items), end]


def _default_lines(layout: Layout, layouts: Layouts) -> Iterator[str]:
    for slot in layout.slots:
        if slot.role is not Role.DATA or slot.field is None:
            continue
        member = f"self.{python_member(slot.name)}"
        if slot.field.default is not None:
            yield f"{member} = {_literal(slot.field.default)}"
        elif isinstance(slot.type, Ref) and any(_default_lines(layouts[slot.type.name], layouts)):
            if slot.count is None:
                yield f"{member}._set_defaults()"
            else:
                yield from (f"for element in {member}:", "    element._set_defaults()")


def _literal(value: Default) -> str:
    match value:
        case tuple():
            return "(" + ", ".join(map(_literal, value)) + (",)" if len(value) == 1 else ")")
        case str():
            return '"' + value.encode("unicode_escape").decode("ascii").replace('"', '\\"') + '"'
        case float() if value != value or value in (float("inf"), float("-inf")):
            return f'float("{value}")'
        case _:
            return repr(value)
