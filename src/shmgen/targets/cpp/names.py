"""Map names to names that C++17 accepts: a namespace for each package and kind, a class for each message."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layout, TypeName
from shmgen.targets.c.names import c_member
from shmgen.targets.naming import ClaimedName, Names, file_stem


def namespace(name: TypeName, package: str) -> str:
    """Return the namespace of a message's class: `shm_msgs::geometry_msgs::msg`."""
    return f"{package}::{c_member(name.package)}::{name.kind}"


def class_name(name: TypeName) -> str:
    """Return the class name of a message, such as `Pose`."""
    return c_member(name.name)


def qualified(name: TypeName, package: str) -> str:
    """Return the fully qualified class name: `::shm_msgs::geometry_msgs::msg::Pose`.

    The name begins at the global namespace, so that no field's name can hide it.
    """
    return f"::{namespace(name, package)}::{class_name(name)}"


def header(name: TypeName, package: str) -> str:
    """Return the include path of a message's header: `shm_msgs/geometry_msgs/msg/pose.hpp`."""
    return f"{package}/{name.package}/{name.kind}/{file_stem(name)}.hpp"


def _claims(layout: Layout, package: str) -> Iterator[ClaimedName]:
    space = namespace(layout.name, package)
    yield ClaimedName("namespace", c_member(layout.name.package), package, layout.name.package)
    yield ClaimedName("class", class_name(layout.name), space)
    if layout.message.constants:
        yield ClaimedName("class", f"{class_name(layout.name)}_Constants", space, is_derived=True)
    for ending in ("Publisher", "Subscriber") if layout.requested else ():
        yield ClaimedName("class", class_name(layout.name) + ending, space, is_derived=True)
    for ending, suffixes in _CALLS.items() if layout.requested else ():
        if layout.name.kind in ("srv", "action") and layout.name.name.endswith(ending):
            whole = layout.name.name.removesuffix(ending)
            for name in suffixes:
                yield ClaimedName("class", whole + name, space, owner=str(layout.name._replace(name=whole)))
    yield ClaimedName("file", header(layout.name, package))


_CALLS = {"_Reply": ("", "Client", "Server"), "_Outcome": ("", "ActionClient", "ActionServer")}
"""The suffixes of a service's and an action's classes, by the message that shmgen adds to each."""


NAMES = Names("C++", member=c_member, constant=c_member, claims=_claims)
