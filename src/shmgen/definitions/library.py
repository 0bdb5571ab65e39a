"""Finds messages by name, in the folders, then in the sourced ROS or the store; reads each file once."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path

from shmgen.core.diagnostics import Report, Span
from shmgen.core.fast_dataclass import dataclass
from shmgen.core.model import Message, TypeName
from shmgen.definitions import store
from shmgen.definitions.catalogue import Catalogue, Definition, Package
from shmgen.definitions.folders import catalogue, read, shorten
from shmgen.definitions.parser import Source, parse
from shmgen.definitions.tokens import Dialect
from shmgen.definitions.wrappers import wrappers


@dataclass(frozen=True, slots=True)
class Sources:
    """Where to look, in this order: the folders of `path`, then the built-in store called `source`.

    `source` is "env" for the ROS that is sourced in this shell, instead of a store.

    `relative_to` is the folder that origins and spans are printed relative to; `written` where each of `path` is said.
    """

    path: tuple[Path, ...] = ()
    source: str = "jazzy"
    relative_to: Path = Path()
    written: Mapping[str, Span] = field(default_factory=dict, compare=False)


@dataclass(slots=True)
class Library:
    """A package is taken whole from the first place that has it, as ROS overlays do.

    One serves any number of loads; `report` is that of the load under way.
    """

    sources: Sources
    report: Report
    folders: Sequence[Catalogue]
    given: dict[str, Package] = field(default_factory=dict)
    beyond: Catalogue | None = None
    _read: dict[Definition, dict[TypeName, Message]] = field(default_factory=dict)

    def begin(self, report: Report) -> None:
        """Of the next load. What the one before complained about is read again, so that it is told again."""
        if self.report.diagnostics:
            self._read.clear()
        self.report = report

    def package(self, name: str) -> Package | None:
        """Reports SHM505 where one place has two of that name."""
        if name in self.given:
            return self.given[name]
        packages = next((found[name] for found in self.folders if name in found), None)
        packages = packages or self._beyond().get(name)
        if packages is None:
            return None
        if len(packages) > 1:
            places = " and ".join(package.place for package in packages)
            hint = "put a COLCON_IGNORE into the one that is not meant"
            self.report.error("SHM505", f"package {name} is in {places}", Span(packages[0].place), hint=hint)
        return packages[0]

    def add(self, package: Package) -> None:
        """One that a file given by its path belongs to; it goes before all others. SHM505 as above."""
        before = self.given.get(package.name, package)
        if before.place != package.place:
            places = f"{before.place} and {package.place}"
            hint = "ask for them in two runs, or name the folders apart"
            self.report.error("SHM505", f"package {package.name} is in {places}", Span(package.place), hint=hint)
        merged = {**before.definitions, **package.definitions}
        self.given[package.name] = Package(package.name, package.place, merged, package.dialect)

    def message(self, name: TypeName) -> Message | None:
        """One of the definitions of its package; None if its file cannot be used, which the report then says."""
        package, definition = self.package(name.package), self.definition(name)
        assert package is not None
        assert definition is not None
        if definition not in self._read:
            text = read(definition, self.report)
            source = Source(definition.name, text or "", definition.path, definition.origin)
            if text is None:
                parsed: tuple[Message, ...] = ()
            elif definition.path.endswith(".idl"):
                from shmgen.definitions import idl  # few need it

                parsed = idl.parse(source, self.report)
            else:
                parsed = parse(source, package.dialect or self._dialect(), self.report)
            made = wrappers(definition.name, definition.path, definition.origin) if parsed else ()
            self._read[definition] = {message.name: message for message in (*parsed, *made)}
        found = self._read[definition].get(_part_of(name) if name not in package.definitions else name)
        return found and replace(found, name=name)

    def definition(self, name: TypeName) -> Definition | None:
        """What holds a message. ROS 1 makes messages of an action, such as `pkg/FooGoal`, which have no file."""
        package = self.package(name.package)
        if package is None:
            return None
        if name not in package.definitions and (package.dialect or self._dialect()) == "ros1":
            name = _part_of(name)
        return package.definitions.get(name)

    def known(self) -> list[TypeName]:
        """All that could be asked for, sorted."""
        packages = dict(self._beyond())
        for found in reversed(self.folders):
            packages |= found
        packages |= {name: (package,) for name, package in self.given.items()}
        return sorted({name for found in packages.values() for package in found for name in package.definitions})

    def files(self) -> list[Path]:
        """Those that were read, and what says how they are to be read: the package.xml above."""
        read = [definition.content for definition in self._read if isinstance(definition.content, Path)]
        above = [folder / "package.xml" for folder in dict.fromkeys(place for file in read for place in file.parents)]
        return [*read, *(file for file in above if file.is_file())]

    def places(self) -> list[str]:
        """Where was looked, for people."""
        folders = [shorten(folder, self.sources.relative_to) for folder in self.sources.path]
        if self.sources.source != "env":
            return [*folders, f"built-in store {self.sources.source}"]
        from shmgen.definitions import environment

        return [*folders, *(shorten(place, self.sources.relative_to) for place in environment.places(os.environ))]

    def _dialect(self) -> Dialect:
        """Of a package that does not say."""
        if self.sources.source == "env":
            from shmgen.definitions import environment

            return environment.dialect(os.environ)
        return store.dialect(self.sources.source)

    def _beyond(self) -> Catalogue:
        """Opened only when no folder has the answer. Raises Rejected: SHM506."""
        if self.beyond is None:
            if self.sources.source == "env":
                from shmgen.definitions import environment

                self.beyond = environment.catalogue(os.environ, self.report)
            else:
                self.beyond = store.catalogue(self.sources.source)
        return self.beyond


def _part_of(name: TypeName) -> TypeName:
    """`pkg/action/Foo_Goal` of `pkg/msg/FooGoal`."""
    return TypeName(name.package, "action", re.sub("(Goal|Result|Feedback)$", r"_\1", name.name))


def open_library(sources: Sources, report: Report) -> Library:
    """Lists the folders, reads nothing. SHM001 for a missing folder, SHM502 for an unknown source; then Rejected."""
    if sources.source not in ("env", *store.names()):
        names = ", ".join(("env", *store.names()))
        report.error("SHM502", f"no source is called {sources.source!r}", Span("source"), hint=f"choose one of {names}")
    written = {sources.relative_to / word: span for word, span in sources.written.items()}
    for folder in sources.path:
        if not folder.is_dir():
            place = written.get(folder, Span(shorten(folder, sources.relative_to)))
            report.error("SHM001", "no such folder", place, hint="correct `path`, or -I")
    report.stop_if_any()
    catalogues = [catalogue(folder, sources.relative_to, report) for folder in sources.path]
    report.stop_if_any()
    return Library(sources, report, catalogues)
