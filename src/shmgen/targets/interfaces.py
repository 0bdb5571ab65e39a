"""Find the services and actions whose messages are all generated. Only these get clients and servers."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layouts, TypeName

REGIONS = {
    "srv": {"request": "_Request", "response": "_Reply"},
    "action": {"request": "_Command", "response": "_Outcome", "progress": "_Progress"},
}
"""The regions of a service and of an action, with the endings of their messages.

The regions have the names of the members of the C structure shmgen_interface.
"""


def complete(layouts: Layouts) -> Iterator[TypeName]:
    """Yield each service, then each action, whose regions have generated messages only, such as `std_srvs/srv/SetBool`.

    For a yielded service, `service.part("_Request")` and `service.part("_Reply")` are the names of its messages.
    """
    for kind, endings in REGIONS.items():
        for name in sorted(layouts):
            if name.kind == kind and name.name.endswith(endings["response"]):
                whole = name._replace(name=name.name.removesuffix(endings["response"]))
                parts = [layouts.get(whole.part(ending)) for ending in endings.values()]
                if all(part and part.requested for part in parts):
                    yield whole
