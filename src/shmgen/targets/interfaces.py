"""Finds the services and actions that the layouts hold whole, so that their clients and servers can be generated."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layouts, TypeName


def services(layouts: Layouts) -> Iterator[TypeName]:
    """`std_srvs/srv/SetBool`, where its request and its reply were asked for; their names are `part`s of it."""
    return _whole(layouts, "srv", "_Request", "_Reply")


def actions(layouts: Layouts) -> Iterator[TypeName]:
    """`control_msgs/action/GripperCommand`, where all that travels was asked for."""
    return _whole(layouts, "action", "_Command", "_Progress", "_Outcome")


def _whole(layouts: Layouts, kind: str, *endings: str) -> Iterator[TypeName]:
    for name in sorted(layouts):
        if name.kind == kind and name.name.endswith(endings[-1]):
            whole = name._replace(name=name.name.removesuffix(endings[-1]))
            parts = [layouts.get(whole.part(ending)) for ending in endings]
            if all(part and part.requested for part in parts):
                yield whole
