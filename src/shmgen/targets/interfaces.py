"""Find the services and actions whose messages are all generated. Only these get clients and servers."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layouts, TypeName

_REGIONS = {"srv": ("_Request", "_Reply"), "action": ("_Command", "_Progress", "_Outcome")}
"""The endings of the messages in the regions of a service and of an action."""


def complete(layouts: Layouts) -> Iterator[TypeName]:
    """Yield each service, then each action, whose regions have generated messages only, such as `std_srvs/srv/SetBool`.

    For a yielded service, `service.part("_Request")` and `service.part("_Reply")` are the names of its messages.
    """
    for kind, endings in _REGIONS.items():
        for name in sorted(layouts):
            if name.kind == kind and name.name.endswith(endings[-1]):
                whole = name._replace(name=name.name.removesuffix(endings[-1]))
                parts = [layouts.get(whole.part(ending)) for ending in endings]
                if all(part and part.requested for part in parts):
                    yield whole
