"""Find messages by name in folders, then in the sourced ROS or a store of rosbags. Read each file once."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Message, TypeName
from shmgen.definitions import environment, store
from shmgen.definitions.catalogue import Catalogue, Definition, Package
from shmgen.definitions.folders import catalogue, read, shorten
from shmgen.definitions.parser import parse
from shmgen.definitions.tokens import Dialect
from shmgen.definitions.wrappers import wrappers


@dataclass(frozen=True, slots=True)
class Sources:
    """The folders to search for definitions, `path`, and the name of the built-in store to search next, `source`.

    If `source` is "env", the ROS that is sourced in this shell replaces the store. Paths are printed relative to
    `relative_to`. `written` maps each folder, as the user spelled it in shmgen.toml, to its position in shmgen.toml.
    """

    path: tuple[Path, ...] = ()
    source: str = "jazzy"
    relative_to: Path = Path()
    written: Mapping[str, Span] = field(default_factory=dict, compare=False)


@dataclass
class Library:
    """Finds and reads messages by name. All messages of a package come from the first folder or store that has it.

    * Several loads can use the same library. `report` receives the diagnostics of the current load.
    * `folders` has the packages of each folder in `sources.path`.
    * `explicit` has the packages of files that the user gave by path. They precede all other packages.
    """

    sources: Sources
    report: Report
    folders: Sequence[Catalogue]
    explicit: dict[str, Package] = field(default_factory=dict)
    _read: dict[Definition, dict[TypeName, Message]] = field(default_factory=dict)

    def reset_report(self, report: Report) -> None:
        """Prepare the library for another load, whose diagnostics go to `report`.

        If the last load had diagnostics, all files are read again, so that the diagnostics are reported again.
        """
        if self.report.diagnostics:
            self._read.clear()
        self.report = report

    def package(self, name: str) -> Package | None:
        """Return the package called `name`, or None. Report SHM505 if one searched folder has two such packages."""
        if name in self.explicit:
            return self.explicit[name]
        packages = next((packages_by_name[name] for packages_by_name in self.folders if name in packages_by_name), None)
        packages = packages or self.fallback.get(name)
        if packages is None:
            return None
        if len(packages) > 1:
            places = " and ".join(package.place for package in packages)
            hint = "add a file COLCON_IGNORE to the folder that shmgen must ignore"
            self.report.error("SHM505", f"package {name} is in {places}", Span(packages[0].place), hint=hint)
        return packages[0]

    def add(self, package: Package) -> None:
        """Add the package of a file that the user gave by path. The package has precedence over all others.

        Report SHM505 if another added package has the same name.
        """
        before = self.explicit.get(package.name, package)
        if before.place != package.place:
            places = f"{before.place} and {package.place}"
            hint = "generate from one file at a time, or rename one of the folders"
            self.report.error("SHM505", f"package {package.name} is in {places}", Span(package.place), hint=hint)
        self.explicit[package.name] = package._replace(definitions={**before.definitions, **package.definitions})

    def message(self, name: TypeName) -> Message | None:
        """Read and return the message `name`, for which definition() must not return None.

        If the file of the definition is not usable, report the errors and return None.
        """
        package, definition = self.package(name.package), self.definition(name)
        assert package is not None
        assert definition is not None
        if definition not in self._read:
            text = read(definition, self.report)
            if text is None:
                parsed: tuple[Message, ...] = ()
            elif definition.path.endswith(".idl"):
                from shmgen.definitions import idl  # imported late because few runs need it

                parsed = idl.parse(definition, text, self.report)
            else:
                parsed = parse(definition, text, package.dialect or self._dialect(), self.report)
            generated = wrappers(definition) if parsed else ()
            self._read[definition] = {message.name: message for message in (*parsed, *generated)}
        message = self._read[definition].get(_action_part(name) if name not in package.definitions else name)
        return message and replace(message, name=name)

    def definition(self, name: TypeName) -> Definition | None:
        """Return the definition that contains a message, or None.

        In ROS 1, an action defines messages such as `pkg/FooGoal`. For such a name, return the definition of the
        action.
        """
        package = self.package(name.package)
        if package is None:
            return None
        if name not in package.definitions and (package.dialect or self._dialect()) == "ros1":
            name = _action_part(name)
        return package.definitions.get(name)

    def known(self) -> list[TypeName]:
        """Return the names of all available messages, sorted."""
        packages = dict(self.fallback)
        for packages_by_name in reversed(self.folders):
            packages |= packages_by_name
        packages |= {name: (package,) for name, package in self.explicit.items()}
        return sorted(
            {name for same_name in packages.values() for package in same_name for name in package.definitions}
        )

    def files(self) -> list[Path]:
        """Return the files that affect the messages: the definitions, and each package.xml in a folder above them.

        A package.xml decides the dialect of its package.
        """
        read = [definition.content for definition in self._read if isinstance(definition.content, Path)]
        above = [folder / "package.xml" for folder in dict.fromkeys(place for file in read for place in file.parents)]
        return [*read, *(file for file in above if file.is_file())]

    def places(self) -> list[str]:
        """Return the names of the searched folders and of the searched store, as diagnostics print them."""
        folders = [shorten(folder, self.sources.relative_to) for folder in self.sources.path]
        if self.sources.source != "env":
            return [*folders, f"built-in store {self.sources.source}"]
        return [*folders, *(shorten(place, self.sources.relative_to) for place in environment.places(os.environ))]

    def _dialect(self) -> Dialect:
        """Return the default dialect, for packages whose manifest names no build tool."""
        if self.sources.source == "env":
            return environment.dialect(os.environ)
        return store.dialect(self.sources.source)

    @cached_property
    def fallback(self) -> Catalogue:
        """The packages of the sourced ROS, or of a store in rosbags. Raises Rejected (SHM506) if no ROS is sourced."""
        if self.sources.source == "env":
            return environment.catalogue(os.environ, self.report)
        return store.catalogue(self.sources.source)


def _action_part(name: TypeName) -> TypeName:
    """Convert the name of a message that ROS 1 generates from an action: `pkg/msg/FooGoal` -> `pkg/action/Foo_Goal`."""
    return TypeName(name.package, "action", re.sub("(Goal|Result|Feedback)$", r"_\1", name.name))


def open_library(sources: Sources, report: Report) -> Library:
    """Return a library that finds messages in the folders, the store or the sourced ROS that `sources` selects.

    This function searches the folders for packages but reads no definition. Raises Rejected if a folder is missing or
    has too many subfolders (SHM001), or if no built-in store has the name `sources.source` (SHM502).
    """
    if sources.source not in ("env", *store.names()):
        names = ", ".join(("env", *store.names()))
        report.error("SHM502", f"unknown source {sources.source!r}", Span("source"), hint=f"choose one of {names}")
    written = {sources.relative_to / word: span for word, span in sources.written.items()}
    for folder in sources.path:
        if not folder.is_dir():
            place = written.get(folder, Span(shorten(folder, sources.relative_to)))
            report.error(
                "SHM001", "no such folder", place, hint="correct `path` in shmgen.toml, or the folder after -I"
            )
    report.stop_if_any()
    catalogues = [catalogue(folder, sources.relative_to, report) for folder in sources.path]
    report.stop_if_any()
    return Library(sources, report, catalogues)
