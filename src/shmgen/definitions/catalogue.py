"""What folders, a sourced ROS and the store have in common: packages of definitions, found but not read yet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import TypeAlias

from shmgen.core.fast_dataclass import dataclass
from shmgen.core.model import TypeName
from shmgen.definitions.parser import SECTIONS
from shmgen.definitions.tokens import Dialect
from shmgen.definitions.wrappers import WRAPPERS


@dataclass(frozen=True, slots=True)
class Definition:
    """A file still to be read, or its text. `path` is what diagnostics print, `origin` what generated files print."""

    name: TypeName
    path: str
    origin: str
    content: Path | str

    @property
    def messages(self) -> tuple[TypeName, ...]:
        """Those it will turn out to hold, and those that are made for it."""
        return tuple(self.name.part(ending) for ending in (*SECTIONS[self.name.kind], *WRAPPERS[self.name.kind]))


@dataclass(frozen=True, slots=True)
class Package:
    """`place` is for people; `definitions` maps the name of each message to the definition that holds it.

    `dialect` is None where nothing but the source, as a whole, can tell.
    """

    name: str
    place: str
    definitions: Mapping[TypeName, Definition] = field(hash=False)
    dialect: Dialect | None = None


Catalogue: TypeAlias = Mapping[str, tuple[Package, ...]]
"""Name -> packages of that name; more than one is a mistake, if it is used."""


def package_of(name: str, place: str, definitions: list[Definition], dialect: Dialect | None = None) -> Package:
    """A package that knows its messages, sorted."""
    held = {message: definition for definition in definitions for message in definition.messages}
    return Package(name, place, dict(sorted(held.items())), dialect)
