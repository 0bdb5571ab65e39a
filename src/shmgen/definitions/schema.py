"""Collects what the user asks for and all that it holds, dependencies first."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeAlias

from shmgen.core.diagnostics import Diagnostic, Report, Span, closest
from shmgen.core.model import Field, Message, Ref, Schema, TypeName, element_of
from shmgen.definitions import folders, habits
from shmgen.definitions.catalogue import Package
from shmgen.definitions.library import Library, Sources, open_library
from shmgen.definitions.parser import SECTIONS
from shmgen.definitions.tokens import shown


def load(requests: Iterable[str], sources: Sources, report: Report) -> Schema:
    """Reads the messages asked for, and all that they hold.

    A request is `geometry_msgs/Pose`, `geometry_msgs/msg/Pose`, `std_srvs/SetBool` (both halves), `geometry_msgs`
    (the whole package) or `path/to/Foo.msg`. Raises Rejected with all that is wrong.
    """
    return load_from(open_library(sources, report), requests, report)


def load_from(library: Library, requests: Iterable[str], report: Report) -> Schema:
    """The same from a library that is open already; what it has read before it does not read again."""
    library.begin(report)
    requested = _requested(requests, library)
    messages = tuple(_closed(requested, library).values())
    report.stop_if_any()
    return Schema(messages, frozenset(requested))


def load_usable(library: Library, requests: Iterable[str], report: Report) -> tuple[Schema, Faults]:
    """What can be used of them, and for each other message what is wrong with it, or with what it holds.

    Raises Rejected if a request itself stands for nothing.
    """
    library.begin(report)
    requested = _requested(requests, library)
    if any(found.code != "SHM505" for found in report.diagnostics):
        report.stop_if_any()
    messages = _closed(requested, library)
    by_place: dict[str, list[Diagnostic]] = {}
    for diagnostic in report.diagnostics:
        by_place.setdefault(diagnostic.span.path, []).append(diagnostic)

    def own(name: TypeName) -> list[Diagnostic]:
        package, definition = library.package(name.package), library.definition(name)
        places = (package.place, definition.path) if package and definition else ()
        return [diagnostic for place in places for diagnostic in by_place.get(place, ())]

    faults: dict[TypeName, tuple[Diagnostic, ...]] = {}
    for name, message in messages.items():
        held = [found for _, it in _held(message) for found in faults.get(it, () if it in messages else own(it))]
        faults[name] = tuple(dict.fromkeys([*own(name), *held]))
    faults = {name: faults.get(name, ()) or tuple(own(name)) for name in {**requested, **messages}}
    usable = tuple(message for name, message in messages.items() if not faults[name])
    broken = {name: faults[name] for name in requested if faults[name]}
    return Schema(usable, frozenset(set(requested) - set(broken))), broken


Faults: TypeAlias = Mapping[TypeName, tuple[Diagnostic, ...]]
_FILES = (*(f".{kind}" for kind in SECTIONS), ".idl")
_REQUEST = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:/(?:(msg|srv|action)/)?([A-Za-z][A-Za-z0-9_]*))?")
_LONGEST_CHAIN_SHOWN = 8


def _requested(requests: Iterable[str], library: Library) -> dict[TypeName, None]:
    """Those in files first, as their packages go before all others."""
    files: list[str] = []
    names: list[str] = []
    for request in requests:
        (files if request.isprintable() and Path(request).suffix in _FILES else names).append(request)
    requested = dict.fromkeys(name for file in files for name in _in_file(Path(file), library))
    return requested | dict.fromkeys(name for request in names for name in _named(request, library))


def _named(request: str, library: Library) -> list[TypeName]:
    """The messages a request stands for; none, with a diagnostic, if it stands for nothing."""
    where = Span(shown(request).strip("`"))
    parts = _REQUEST.fullmatch(request)
    if parts is None:
        hint = "write `package/Name`, `package`, or the path of a .msg, .srv, .action or .idl file"
        meant = re.sub(r"::|\.", "/", request).replace("-", "_")
        if meant in {name for known in library.known() for name in (str(known), known.short, known.package)}:
            hint = f"did you mean `{meant}`?"
        elif Path(request).is_dir():
            hint = f"a folder of packages is given with -I: `-I {request} package`"
        library.report.error("SHM004", f"{shown(request)} is not the name of a message", where, hint=hint)
        return []
    package_name, kind, name = parts.groups()
    package = library.package(package_name)
    held = package.definitions if package else {}
    if name is None:
        found = list(held)
    else:
        found = [held_name for held_name in held if name == held_name.name and kind in (None, held_name.kind)]
        found = found or [other for other in held if name == held[other].name.name and kind in (None, other.kind)]
        found = found or [made for made in (TypeName(package_name, kind or "msg", name),) if library.definition(made)]
    if not found:
        wanted = TypeName(package_name, kind or "msg", name or "")
        hint = _hint(wanted, library, package)
        what = "message type" if name else "message package"
        library.report.error("SHM004", f"unknown {what} {shown(request)}", where, hint=hint)
    return found


def _in_file(file: Path, library: Library) -> list[TypeName]:
    """Its package goes before all others, so that the file finds those beside it."""
    package = folders.package_around(file, library.sources.relative_to)
    if package is None:
        hint = "rename the folder, or put a package.xml with a <name> into it"
        library.report.error("SHM202", "the folder's name cannot be a package's", Span(str(file)), hint=hint)
        return []
    if not file.exists():
        hint = "a message is named by package and name, `geometry_msgs/Pose`, or by the path of its file"
        library.report.error("SHM001", "no such file", Span(str(file)), hint=hint)
        return []
    library.add(package)
    kind = folders.kind_of(file)
    return list(package.definitions[TypeName(package.name, kind, file.stem + SECTIONS[kind][0])].messages)


def _closed(requested: Iterable[TypeName], library: Library) -> dict[TypeName, Message]:
    """Dependencies first: depth first, with a stack of our own so that no nest is too deep."""
    done: dict[TypeName, Message] = {}
    seen: set[TypeName] = set()
    for root in requested:
        path: dict[TypeName, tuple[Message, Iterator[tuple[Field, TypeName]]]] = {}
        entered: TypeName | None = root
        while entered or path:
            if entered and entered not in seen:
                seen.add(entered)
                if opened := library.message(entered):
                    path[entered] = opened, _held(opened)
            entered = None
            if path:
                message, held = path[next(reversed(path))]
                entered = next(
                    (other for field, other in held if _leads_on(message, field, other, path, library)), None
                )
                if entered is None:
                    del path[message.name]
                    done[message.name] = message
    return done


def _held(message: Message) -> Iterator[tuple[Field, TypeName]]:
    """The messages that its fields hold by value."""
    for field in message.fields:
        element = element_of(field.type)
        if isinstance(element, Ref):
            yield field, element.name


def _leads_on(message: Message, field: Field, other: TypeName, path: Collection[TypeName], library: Library) -> bool:
    """Whether `other` can be looked into; if not, the report says why."""
    where = f"{message.name.short}.{field.name}"
    if library.report.is_enough(field.span.path):
        return False
    if other in path:
        chain = [name.short for name in path]
        chain = [*chain[chain.index(other.short) :], other.short]
        if len(chain) > _LONGEST_CHAIN_SHOWN:
            chain = [*chain[:4], f"… {len(chain) - 7} more …", *chain[-3:]]
        hint = "a message cannot hold itself: take one of these fields out"
        library.report.error("SHM301", f"recursive: {' -> '.join(chain)}", field.span, field=where, hint=hint)
        return False
    if library.definition(other) is None:
        hint = _hint(other, library, library.package(other.package))
        hint = "\n".join(filter(None, [habits.hint(field.span.text), hint]))
        library.report.error("SHM004", f"unknown message type {shown(other.short)}", field.span, field=where, hint=hint)
        return False
    return True


def _hint(wanted: TypeName, library: Library, package: Package | None) -> str:
    """What may have been meant, and where was looked."""
    names = library.known()
    known = list(dict.fromkeys(whole for name in names for whole in (name.short, _whole(name))))
    word = (wanted.name or wanted.package).lower()
    guesses = [short for short in known if short.partition("/")[2].lower() == word][:3]
    packages = dict.fromkeys(name.package for name in names)
    close = closest(wanted.short, known, 0.8) if wanted.name else closest(wanted.package, packages, 0.8)
    if package is not None and not close.startswith(f"{wanted.package}/") and (meant := habits.builtin(wanted.name)):
        guesses = [meant, *guesses]
    guesses = guesses or ([close] if close else [])
    lines = [f"did you mean {' or '.join(f'`{guess}`' for guess in guesses)}?"] if guesses else []
    lines.append(f"looked in {package.place if package else ', '.join(library.places())}")
    if package is None:
        lines.append("a folder of other packages is given with -I, or as `path` in shmgen.toml")
        inside = [folder for folder in library.sources.path if folder.name in SECTIONS]
        lines += [f"give {folder.parent.name}/, the package, not its {folder.name}/" for folder in inside]
    return "\n".join(lines)


def _whole(name: TypeName) -> str:
    """Of a part of a service or an action: `std_srvs/SetBool`."""
    return name.short if name.kind == "msg" else name.short.rpartition("_")[0]
