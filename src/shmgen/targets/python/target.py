"""Generate the Python package: ctypes classes with their publishers and subscribers."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from shmgen.core import table
from shmgen.core.diagnostics import Report
from shmgen.core.model import Layout, Output, Regions, Role, TypeName
from shmgen.core.plural import counted
from shmgen.targets import Job
from shmgen.targets.python import interfaces
from shmgen.targets.python.members import Line, annotation, hiding, rows
from shmgen.targets.python.names import NAMES as NAMES
from shmgen.targets.python.names import PYTHON_USED, classes, module, python_class, python_member
from shmgen.targets.python.text import documentation, import_lines, in_docstring, literal, sort_key

_BESIDE = "_beside"
"""The folder of the copied runtime, below the generated package. The generated code appends it to `sys.path`."""
_CORE = ("__init__.py", "abi.py", "escape.py", "plural.py", "table.py")
"""The files of `shmgen/core` that the runtime imports."""


class Module(NamedTuple):
    """The template data for the module of one message. The template inserts all strings unchanged.

    `rows` are the lines of the table of fields in the generated class.
    """

    title: str
    origin: str
    size: str
    size_literal: int
    digest: str
    digest_literal: str
    version: int
    regions: str
    imports: tuple[str, ...]
    class_name: str
    summary: str
    doc: tuple[str, ...]
    rows: tuple[str, ...]
    defaults: tuple[Line, ...]
    constants: tuple[Line, ...]
    annotations: tuple[Line, ...]
    hiding: tuple[str, ...]
    requested: bool


class Root(NamedTuple):
    """The template data for the `__init__.py` of the top package.

    `beside` is the folder with the included runtime, or `""` if the package does not include the runtime. `needs` is
    the advice in the error message for a missing Python package.
    """

    beside: str
    needs: str


class Package(NamedTuple):
    """The template data for an `__init__.py` that imports the classes of its modules."""

    title: str
    imports: tuple[str, ...]
    names: tuple[str, ...]


class Project(NamedTuple):
    """The template data for the pyproject.toml."""

    name: str
    version: str
    package: str
    needs: str


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield `python/<package>/<ros package>/msg/_pose.py` for each message, and the `__init__.py` files above.

    If shmgen.toml sets `distribution`, also yield a pyproject.toml. If shmgen.toml sets `runtime = "beside"`,
    also yield the runtime's files in a folder of the package.
    """
    layouts = job.layouts
    regions = _options_text(job.options.regions)
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
            view = _module(layout, regions)
            yield Output(f"{folder}/{module(layout.name)}.py", "python/message.py.j2", view)
    yield from interfaces.plan(layouts, root)
    if job.options.beside:
        yield from _runtime(root)
    if job.options.distribution:
        name, _, version = job.options.distribution.partition(" ")
        needs = "posix_ipc>=1.1" if job.options.beside else "shmgen"
        project = Project(name, version, job.package, needs)
        yield Output("python/pyproject.toml", "python/pyproject.toml.j2", project)


def _runtime(root: str) -> Iterator[Output]:
    """Yield the files of shmgen's runtime in `<root>/_beside/shmgen/`, and a README.txt with the licence.

    The generated package then runs on a robot without shmgen.
    """
    package = Path(__file__).parents[2]
    runtime = sorted(file.relative_to(package).as_posix() for file in (package / "runtime").rglob("*.py"))
    for path in ("__init__.py", "py.typed", *(f"core/{name}" for name in _CORE), *runtime):
        yield Output(f"{root}/{_BESIDE}/shmgen/{path}", f"shmgen/{path}", None)
    yield Output(f"{root}/{_BESIDE}/shmgen/README.txt", "python/beside.txt", None)


def _root(brings: bool) -> Root:
    return Root(_BESIDE, "install it") if brings else Root("", "install shmgen, or shmgen-runtime alone,")


def _package(ros_package: str, kind: str, layouts: list[Layout]) -> Package:
    modules = {f".{module(layout.name)}": classes(layout) for layout in layouts}
    modules |= interfaces.classes({layout.name: layout for layout in layouts})
    imports = tuple(line for name in sorted(modules, key=sort_key) for line in import_lines(name, modules[name]))
    names = sorted((name for names in modules.values() for name in names), key=sort_key)
    return Package(f"Messages of {ros_package}/{kind} in shared memory", imports, tuple(names))


def _options_text(regions: Regions) -> str:
    """Return the Python call with the settings in `[regions]`, such as `runtime.RegionOptions(mode=0o660)`.

    Return `""` if all settings have their defaults.
    """
    arguments = [] if regions.mode is None else [f"mode=0o{regions.mode:o}"]
    arguments += [f"group={literal(regions.group)}"] if regions.group else []
    arguments += [f"sync={literal(regions.sync)}"] if regions.sync != "lock" else []
    return f"runtime.RegionOptions({', '.join(arguments)})" if arguments else ""


def _module(layout: Layout, regions: str) -> Module:
    names = _imported_names(layout)
    message = layout.message
    data = [slot for slot in layout.slots if slot.role is Role.DATA]
    defaults = [(slot.name, slot.field.default) for slot in data if slot.field and slot.field.default is not None]
    constants = [Line(python_member(it.name), type(it.value).__name__, literal(it.value)) for it in message.constants]
    annotations = [Line(python_member(slot.name), annotation(slot, names)) for slot in data]
    used = PYTHON_USED | set(names.values())
    return Module(
        title=str(layout.name),
        origin=in_docstring(message.origin),
        size=counted(layout.size, "byte"),
        size_literal=layout.size,
        digest=f"{layout.digest:016x}",
        digest_literal=f"0x{layout.digest:016X}",
        version=table.VERSION,
        regions=regions,
        imports=tuple(_imports(layout, names, any("typing." in row.type for row in annotations) or bool(constants))),
        class_name=python_class(layout.name),
        summary=in_docstring(message.doc.partition("\n")[0]) or f"{layout.name.short}.",
        doc=tuple(documentation(message)),
        rows=tuple(rows(layout, names)),
        defaults=tuple(Line(python_member(name), value=literal(value)) for name, value in defaults),
        constants=tuple(row for row in constants if row.name not in used),
        annotations=tuple(row for row in annotations if row.name not in used),
        hiding=tuple(hiding(annotations, constants, used)),
        requested=layout.requested,
    )


def _imported_names(layout: Layout) -> dict[TypeName, str]:
    """Return the name that a message's module uses for the class of each contained message.

    If two class names are equal, the second name gets its ROS package as a prefix.
    """
    used = {python_class(layout.name)}
    names: dict[TypeName, str] = {}
    for name in layout.dependencies:
        bare = python_class(name)
        names[name] = f"{name.package}_{bare}" if bare in used else bare
        used.add(names[name])
    return names


def _imports(layout: Layout, names: dict[TypeName, str], is_typed: bool) -> Iterator[str]:
    if is_typed:
        yield from ("import typing", "")
    yield "from shmgen import runtime"
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
