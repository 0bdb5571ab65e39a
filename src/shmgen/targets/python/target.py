"""Turns Layouts into the Python package of ctypes classes with their publishers and subscribers."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Layout, Layouts, Output, Ref, Regions, Role, TypeName
from shmgen.core.plural import counted
from shmgen.targets import Job
from shmgen.targets.python import beside, codec, interfaces, project
from shmgen.targets.python.members import Line, annotation, ctype, descriptor, hiding, is_shown, stored_name
from shmgen.targets.python.names import NAMES as NAMES
from shmgen.targets.python.names import PYTHON_USED, classes, module, python_class, python_member
from shmgen.targets.python.text import documentation, import_lines, in_docstring, literal, sort_key


class Module(NamedTuple):
    """One message; all strings finished, `encode` and `decode` one statement line each."""

    title: str
    origin: str
    size: str
    digest: str
    digest_literal: str
    regions: str
    imports: tuple[str, ...]
    class_name: str
    structs: tuple[Line, ...]
    rows: tuple[Line, ...]
    summary: str
    doc: tuple[str, ...]
    fields: tuple[Line, ...]
    names: tuple[str, ...]
    constants: tuple[Line, ...]
    plain: tuple[Line, ...]
    shown: tuple[Line, ...]
    hiding: tuple[str, ...]
    encode: tuple[str, ...]
    decode: tuple[str, ...]
    defaults: tuple[str, ...]
    requested: bool


class Root(NamedTuple):
    """The `__init__.py` above all; `beside` is the folder with the runtime, where it is not left to be installed."""

    title: str
    beside: str
    needs: str


class Package(NamedTuple):
    """An `__init__.py` that lifts the classes of its modules."""

    title: str
    imports: tuple[str, ...]
    names: tuple[str, ...]


def plan(job: Job, report: Report) -> Iterator[Output]:
    """`python/<package>/<ros package>/msg/_pose.py` for each message, and the packages above them.

    With a `distribution` in shmgen.toml a pyproject.toml too, which makes them installable; with
    `runtime = "beside"` the runtime's own files, in a folder of the package.
    """
    layouts = job.layouts
    regions = _spelled(job.options.regions)
    root = f"python/{job.package}"
    yield Output(f"{root}/__init__.py", "python/root.py.j2", _root(job.options.beside))
    yield Output(f"{root}/py.typed", "python/py.typed.j2", None)
    for ros_package in dict.fromkeys(name.package for name in sorted(layouts)):
        title = f"Messages of {ros_package} in shared memory"
        yield Output(f"{root}/{python_member(ros_package)}/__init__.py", "python/package.py.j2", Package(title, (), ()))
    folder_of = lambda name: (name.package, name.kind)  # noqa: E731
    for (ros_package, kind), names in groupby(sorted(layouts), key=folder_of):
        folder = f"{root}/{python_member(ros_package)}/{kind}"
        members = [layouts[name] for name in names]
        yield Output(f"{folder}/__init__.py", "python/package.py.j2", _package(ros_package, kind, members))
        for layout in members:
            view = _module(layout, layouts, regions)
            yield Output(f"{folder}/{module(layout.name)}.py", "python/message.py.j2", view)
    yield from interfaces.plan(layouts, root)
    if job.options.beside:
        yield from beside.plan(root)
    if job.options.distribution:
        yield project.plan(job.options.distribution, job.package, job.options.beside)


def _root(brings: bool) -> Root:
    title = "Messages in shared memory"
    return (
        Root(title, beside.FOLDER, "install it")
        if brings
        else Root(title, "", "install shmgen, or shmgen-runtime alone,")
    )


def _package(ros_package: str, kind: str, layouts: list[Layout]) -> Package:
    modules = {f".{module(layout.name)}": classes(layout) for layout in layouts}
    modules |= interfaces.classes({layout.name: layout for layout in layouts})
    imports = tuple(line for found in sorted(modules, key=sort_key) for line in import_lines(found, modules[found]))
    names = sorted((name for names in modules.values() for name in names), key=sort_key)
    return Package(f"Messages of {ros_package}/{kind} in shared memory", imports, tuple(names))


def _spelled(regions: Regions) -> str:
    """The call that makes them; nothing where shmgen.toml says nothing."""
    said = [] if regions.mode is None else [f"mode=0o{regions.mode:o}"]
    said += [f"group={literal(regions.group)}"] if regions.group else []
    said += [f"sync={literal(regions.sync)}"] if regions.sync != "lock" else []
    return f"runtime.RegionOptions({', '.join(said)})" if said else ""


def _module(layout: Layout, layouts: Layouts, regions: str) -> Module:
    names = _imported_names(layout, layouts)
    made = codec.Codec(layouts, names)
    made.message(layout)
    structs = [f"_STRUCT{index if len(made.runs) > 1 else ''}" for index in range(len(made.runs))]
    message = layout.message
    data = [slot for slot in layout.slots if slot.role is Role.DATA]
    counts = {slot.name.removesuffix("_count"): slot.offset for slot in layout.slots if slot.role is Role.COUNT}
    shown = [slot for slot in data if is_shown(slot)]
    plain = [slot for slot in data if not is_shown(slot)]
    encode = tuple(made.encode_lines(structs))
    fields = tuple(Line(stored_name(slot), ctype(slot, layout.options, names)) for slot in layout.slots)
    descriptors = [
        Line(python_member(slot.name), value=descriptor(slot, layout.options, names, counts.get(slot.name)))
        for slot in shown
    ]
    constants = [Line(python_member(it.name), type(it.value).__name__, literal(it.value)) for it in message.constants]
    annotations = [Line(python_member(slot.name), annotation(slot.type, names)) for slot in plain]
    used = PYTHON_USED | set(names.values())
    uses_ctypes = any("ctypes." in row.type + row.value for row in (*fields, *descriptors))
    return Module(
        title=str(layout.name),
        origin=in_docstring(message.origin),
        size=counted(layout.size, "byte"),
        digest=f"{layout.digest:016x}",
        digest_literal=f"0x{layout.digest:016X}",
        regions=regions,
        imports=tuple(_imports(layout, names, bool(structs), uses_ctypes, bool(encode or shown))),
        class_name=python_class(layout.name),
        structs=tuple(Line(name, value=run.format) for name, run in zip(structs, made.runs, strict=True)),
        rows=tuple(Line(path, code) for path, code in made.rows),
        summary=in_docstring(message.doc.partition("\n")[0]) or f"{layout.name.short}.",
        doc=tuple(documentation(message)),
        fields=fields,
        names=tuple(python_member(slot.name) for slot in data),
        constants=tuple(row for row in constants if row.name not in used),
        plain=tuple(row for row in annotations if row.name not in used),
        shown=tuple(row for row in descriptors if row.name not in used),
        hiding=tuple(hiding(annotations, [*constants, *descriptors], used)),
        encode=encode,
        decode=tuple(made.decode_lines(structs)),
        defaults=tuple(_default_lines(layout, layouts)),
        requested=layout.requested,
    )


def _imported_names(layout: Layout, layouts: Layouts) -> dict[TypeName, str]:
    """The bare class name, with its package before it where two would be the same."""
    taken = {python_class(layout.name)}
    names: dict[TypeName, str] = {}
    for name in dict.fromkeys((*layout.dependencies, *_array_elements(layout, layouts))):
        bare = python_class(name)
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
        place = f".{module(name)}" if near else f"...{python_member(name.package)}.{name.kind}.{module(name)}"
        bare = python_class(name)
        modules[place] = bare if bare == imported else f"{bare} as {imported}"
    if modules:
        yield ""
    for place in sorted(modules, key=lambda place: (not place.startswith("..."), sort_key(place))):
        yield from import_lines(place, [modules[place]])


def _default_lines(layout: Layout, layouts: Layouts) -> Iterator[str]:
    for slot in layout.slots:
        if slot.role is not Role.DATA or slot.field is None:
            continue
        member = f"self.{python_member(slot.name)}"
        if slot.field.default is not None:
            yield f"{member} = {literal(slot.field.default)}"
        elif isinstance(slot.type, Ref) and any(_default_lines(layouts[slot.type.name], layouts)):
            if slot.count is None:
                yield f"{member}._set_defaults()"
            else:
                yield from (f"for element in {member}:", "    element._set_defaults()")
