"""Names that C++17 accepts: a namespace for each package and kind, a class for each message."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layout, TypeName
from shmgen.targets.c.names import c_member
from shmgen.targets.naming import ClaimedName, Names, file_stem


def cpp_name(name: str) -> str:
    """A field, a constant, a class or a package: `default` -> `default_`."""
    return c_member(name)


def namespace(name: TypeName, package: str) -> str:
    """Where the class of a message is: `shm_msgs::geometry_msgs::msg`."""
    return f"{package}::{cpp_name(name.package)}::{name.kind}"


def class_name(name: TypeName) -> str:
    """`Pose`."""
    return cpp_name(name.name)


def qualified(name: TypeName, package: str) -> str:
    """From the outermost namespace, so that no field's name can hide it: `::shm_msgs::geometry_msgs::msg::Pose`."""
    return f"::{namespace(name, package)}::{class_name(name)}"


def header(name: TypeName, package: str) -> str:
    """The file of a message, as it is included: `shm_msgs/geometry_msgs/msg/pose.hpp`."""
    return f"{package}/{name.package}/{name.kind}/{file_stem(name)}.hpp"


def _made(layout: Layout, package: str) -> Iterator[ClaimedName]:
    space = namespace(layout.name, package)
    yield ClaimedName("namespace", cpp_name(layout.name.package), package, layout.name.package)
    yield ClaimedName("class", class_name(layout.name), space)
    if layout.message.constants:
        yield ClaimedName("class", f"{class_name(layout.name)}_Constants", space, follows=True)
    for ending in ("Publisher", "Subscriber") if layout.requested else ():
        yield ClaimedName("class", class_name(layout.name) + ending, space, follows=True)
    for ending, made in _CALLS.items() if layout.requested else ():
        if layout.name.kind in ("srv", "action") and layout.name.name.endswith(ending):
            whole = layout.name.name.removesuffix(ending)
            for name in made:
                yield ClaimedName("class", whole + name, space, of=str(layout.name._replace(name=whole)))
    yield ClaimedName("file", header(layout.name, package))


_CALLS = {"_Reply": ("", "Client", "Server"), "_Outcome": ("", "ActionClient", "ActionServer")}
"""What a service or an action becomes, told by the part that shmgen makes of it."""


NAMES = Names("C++", member=cpp_name, constant=cpp_name, made=_made)
