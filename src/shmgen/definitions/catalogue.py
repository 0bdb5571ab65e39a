"""Packages of definitions that are found but not read yet.

Folders, a sourced ROS and the built-in store are all searched for such packages.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, TypeAlias

from shmgen.core.model import TypeName
from shmgen.definitions.tokens import Dialect

SECTIONS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
"""Kind of file -> the endings of its messages' names."""
WRAPPERS = {"msg": (), "srv": ("_Reply",), "action": ("_Command", "_Progress", "_Outcome")}
"""Kind of file -> the endings of its wrappers' names."""


class Definition(NamedTuple):
    """A definition that is not read yet. `content` is the path of its file, or its text.

    `name` is the type that the file defines, such as std_srvs/srv/SetBool. Diagnostics print `path`, and
    generated files print `origin`.
    """

    name: TypeName
    path: str
    origin: str
    content: Path | str

    @property
    def messages(self) -> tuple[TypeName, ...]:
        """The names of the messages in the definition, and of the wrappers that shmgen generates for the definition.

        A wrapper combines a part of a service or an action with the number of its call or goal.
        """
        return tuple(self.name.part(ending) for ending in (*SECTIONS[self.name.kind], *WRAPPERS[self.name.kind]))


class Package(NamedTuple):
    """A package of definitions. `place` is the path of its folder or the name of its store, for diagnostics.

    `definitions` maps the name of each message to the definition that contains the message. `dialect` is None if the
    package does not name its dialect; the package then gets the default dialect of the library.
    """

    name: str
    place: str
    definitions: Mapping[TypeName, Definition]
    dialect: Dialect | None = None


Catalogue: TypeAlias = Mapping[str, tuple[Package, ...]]
"""Name -> packages of this name. If a request needs a name that has more than one package, SHM505 is reported."""


def package_of(name: str, place: str, definitions: list[Definition], dialect: Dialect | None = None) -> Package:
    """Return a package with its messages in order of name."""
    by_message = {message: definition for definition in definitions for message in definition.messages}
    return Package(name, place, dict(sorted(by_message.items())), dialect)
