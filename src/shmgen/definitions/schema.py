"""Collect the requested messages and all messages that they contain, dependencies first."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from shmgen.core.diagnostics import Diagnostic, Report, Span, closest
from shmgen.core.model import OTHER_NAMES, Field, Message, Ref, Schema, TypeName, element_of
from shmgen.definitions import folders, syntax_hints
from shmgen.definitions.catalogue import SECTIONS, Package
from shmgen.definitions.library import Library
from shmgen.definitions.tokens import quote


def load(library: Library, requests: Iterable[str], report: Report) -> Schema:
    """Read the requested messages, and all messages that they contain. The library reads no file a second time.

    A request is `geometry_msgs/Pose`, `geometry_msgs/msg/Pose`, `std_srvs/SetBool` (request and response),
    `geometry_msgs` (the whole package) or `path/to/Foo.msg`. Raises Rejected with all diagnostics if there is an error.
    """
    library.reset_report(report)
    requested = _requested(requests, library)
    messages = tuple(_with_dependencies(requested, library).values())
    report.stop_if_any()
    return Schema(messages, frozenset(requested))


def load_usable(library: Library, requests: Iterable[str], report: Report) -> tuple[Schema, Faults]:
    """Return the usable messages, and the errors of each requested message that is not usable.

    A message is usable if it has no errors and contains only usable messages. Raises Rejected if a request matches
    no message.
    """
    library.reset_report(report)
    requested = _requested(requests, library)
    if any(diagnostic.code != "SHM505" for diagnostic in report.diagnostics):
        report.stop_if_any()
    messages = _with_dependencies(requested, library)
    by_place: dict[str, list[Diagnostic]] = {}
    for diagnostic in report.diagnostics:
        by_place.setdefault(diagnostic.span.path, []).append(diagnostic)

    def own(name: TypeName) -> list[Diagnostic]:
        package, definition = library.package(name.package), library.definition(name)
        places = (package.place, definition.path) if package and definition else ()
        return [diagnostic for place in places for diagnostic in by_place.get(place, ())]

    faults: dict[TypeName, tuple[Diagnostic, ...]] = {}
    for name, message in messages.items():
        inherited = [
            diagnostic
            for _, other in _references(message)
            for diagnostic in faults.get(other, () if other in messages else own(other))
        ]
        faults[name] = tuple(dict.fromkeys([*own(name), *inherited]))
    faults = {name: faults.get(name, ()) or tuple(own(name)) for name in {**requested, **messages}}
    usable = tuple(message for name, message in messages.items() if not faults[name])
    broken = {name: faults[name] for name in requested if faults[name]}
    return Schema(usable, frozenset(set(requested) - set(broken))), broken


Faults: TypeAlias = Mapping[TypeName, tuple[Diagnostic, ...]]
_FILES = (*(f".{kind}" for kind in SECTIONS), ".idl")
_REQUEST = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:/(?:(msg|srv|action)/)?([A-Za-z][A-Za-z0-9_]*))?")
_LONGEST_CHAIN_SHOWN = 8


def _requested(requests: Iterable[str], library: Library) -> dict[TypeName, None]:
    """Return the requested messages. Requests for files come first, because their packages have precedence."""
    files: list[str] = []
    names: list[str] = []
    for request in requests:
        (files if request.isprintable() and Path(request).suffix in _FILES else names).append(request)
    requested = dict.fromkeys(name for file in files for name in _in_file(Path(file), library))
    return requested | dict.fromkeys(name for request in names for name in _find_matching(request, library))


def _find_matching(request: str, library: Library) -> list[TypeName]:
    """Return the messages that match `request`, the name of a message, a service or a package.

    Report SHM004 if no message matches.
    """
    where = Span(quote(request).strip("`"))
    parts = _REQUEST.fullmatch(request)
    if parts is None:
        hint = "write `package/Name`, `package`, or the path of a .msg, .srv, .action or .idl file"
        similar = re.sub(r"::|\.", "/", request).replace("-", "_")
        if similar in {name for known in library.known() for name in (str(known), known.short, known.package)}:
            hint = f"did you mean `{similar}`?"
        elif Path(request).is_dir():
            hint = f"give a folder of packages with -I: `-I {request} package`"
        library.report.error("SHM004", f"{quote(request)} is not the name of a message", where, hint=hint)
        return []
    package_name, kind, name = parts.groups()
    package = library.package(package_name)
    definitions = package.definitions if package else {}
    if name is None:
        matches = list(definitions)
    else:
        matches = [available for available in definitions if name == available.name and kind in (None, available.kind)]
        matches = matches or [
            other for other in definitions if name == definitions[other].name.name and kind in (None, other.kind)
        ]
        candidate = TypeName(package_name, kind or "msg", name)
        matches = matches or ([candidate] if library.definition(candidate) else [])
    if not matches:
        missing = TypeName(package_name, kind or "msg", name or "")
        hint = _hint(missing, library, package)
        what = "message type" if name else "message package"
        library.report.error("SHM004", f"unknown {what} {quote(request)}", where, hint=hint)
    return matches


def _in_file(file: Path, library: Library) -> list[TypeName]:
    """Return the messages in a definition file.

    Also add the package around the file to the library, because the messages may contain others of this package.
    """
    around = folders.package_around(file, library.sources.relative_to)
    if around is None:
        hint = "rename the folder, or add a package.xml with a <name>"
        library.report.error("SHM202", "the name of the folder is not a valid package name", Span(str(file)), hint=hint)
        return []
    if not file.exists():
        hint = "give a message as package and name, `geometry_msgs/Pose`, or as the path of its file"
        library.report.error("SHM001", "no such file", Span(str(file)), hint=hint)
        return []
    package, definition = around
    library.add(package)
    return list(definition.messages)


def _with_dependencies(requested: Iterable[TypeName], library: Library) -> dict[TypeName, Message]:
    """Return the requested messages and all messages that they contain, dependencies first.

    The search is depth first, without recursion, so that deep nesting cannot exceed Python's recursion limit.
    """
    done: dict[TypeName, Message] = {}
    seen: set[TypeName] = set()
    for root in requested:
        path: dict[TypeName, tuple[Message, Iterator[tuple[Field, TypeName]]]] = {}
        entered: TypeName | None = root
        while entered or path:
            if entered and entered not in seen:
                seen.add(entered)
                if opened := library.message(entered):
                    path[entered] = opened, _references(opened)
            entered = None
            if path:
                message, references = path[next(reversed(path))]
                entered = next(
                    (other for field, other in references if _check_reference(message, field, other, path, library)),
                    None,
                )
                if entered is None:
                    del path[message.name]
                    done[message.name] = message
    return done


def _references(message: Message) -> Iterator[tuple[Field, TypeName]]:
    """Yield each field that contains another message, with the name of the other message."""
    for field in message.fields:
        element = element_of(field.type)
        if isinstance(element, Ref):
            yield field, element.name


def _check_reference(
    message: Message, field: Field, other: TypeName, path: Collection[TypeName], library: Library
) -> bool:
    """Check a field that contains the message `other`. Return True if the search should continue with `other`.

    Report SHM301 if the message contains itself, and SHM004 if `other` has no definition. After too many errors in a
    file, report nothing and return False.
    """
    where = f"{message.name.short}.{field.name}"
    if library.report.is_enough(field.span.path):
        return False
    if other in path:
        chain = [name.short for name in path]
        chain = [*chain[chain.index(other.short) :], other.short]
        if len(chain) > _LONGEST_CHAIN_SHOWN:
            chain = [*chain[:4], f"… {len(chain) - 7} more …", *chain[-3:]]
        hint = "remove one field of this chain: a message cannot contain itself"
        library.report.error("SHM301", f"recursive: {' -> '.join(chain)}", field.span, field=where, hint=hint)
        return False
    if library.definition(other) is None:
        hint = _hint(other, library, library.package(other.package), message.name)
        of_line = "" if field.span.path.endswith(".idl") else syntax_hints.hint(field.span.text)
        hint = "\n".join(filter(None, [of_line, hint]))
        library.report.error("SHM004", f"unknown message type {quote(other.short)}", field.span, field=where, hint=hint)
        return False
    return True


def _hint(missing: TypeName, library: Library, package: Package | None, within: TypeName | None = None) -> str:
    """Return the hint for a missing message: messages with similar names, and the searched places.

    `within` is the message that refers to the missing message. The hint does not suggest `within`.
    """
    guesses = _guesses(missing, [name for name in library.known() if name != within], package)
    lines = [f"did you mean {' or '.join(f'`{guess}`' for guess in guesses)}?"] if guesses else []
    lines.append(f"looked in {package.place if package else ', '.join(library.places())}")
    if package is None:
        lines.append("give a folder of other packages with -I, or as `path` in shmgen.toml")
        inside = [folder for folder in library.sources.path if folder.name in SECTIONS]
        lines += [
            f"give the package's folder {folder.parent.name}/ instead of its folder {folder.name}/" for folder in inside
        ]
    return "\n".join(lines)


def _guesses(missing: TypeName, known: Sequence[TypeName], package: Package | None) -> list[str]:
    """Return up to four names that the user may have meant by a missing message.

    The result is a built-in type that has this name in another language, or messages with similar names.
    """
    word = missing.name or missing.package
    names = list(
        dict.fromkeys(
            whole for name in known for whole in (name.short, _definition_name(name)) if whole != missing.short
        )
    )
    alike = [name for name in names if name.partition("/")[2].lower() == word.lower()][:3]
    builtin = syntax_hints.builtin(word)
    if not missing.name:
        of_std = [name for name in names if builtin and name.lower() == f"std_msgs/{builtin}"]
        close = closest(word, {name.package for name in known}, 0.8)
        return alike or of_std or ([close] if close else [])
    near = closest(missing.name, [name.name for name in known if name.package == missing.package], 0.7)
    if builtin and package is not None and (word in OTHER_NAMES or not near):
        return [builtin, *alike]
    if near and not alike:
        return [f"{missing.package}/{near}"]
    close = closest(missing.short, [name for name in names if not name.startswith(f"{missing.package}/")], 0.8)
    return alike or ([close] if close else [])


def _definition_name(name: TypeName) -> str:
    """Return the short name of a message, or of the service or action that contains it, such as `std_srvs/SetBool`."""
    return name.short if name.kind == "msg" else name.short.rpartition("_")[0]
