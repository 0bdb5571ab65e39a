"""Find the services and actions whose messages are all generated. Only these get clients and servers."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layouts, TypeName


def services(layouts: Layouts) -> Iterator[TypeName]:
    """Yield each service whose request and reply messages are both generated, such as `std_srvs/srv/SetBool`.

    For a yielded `service`, `service.part("_Request")` and `service.part("_Reply")` are the names of its messages.
    """
    return _whole(layouts, "srv", "_Request", "_Reply")


def actions(layouts: Layouts) -> Iterator[TypeName]:
    """Yield each action whose messages are all generated, such as `control_msgs/action/GripperCommand`."""
    return _whole(layouts, "action", "_Command", "_Progress", "_Outcome")


def _whole(layouts: Layouts, kind: str, *endings: str) -> Iterator[TypeName]:
    for name in sorted(layouts):
        if name.kind == kind and name.name.endswith(endings[-1]):
            whole = name._replace(name=name.name.removesuffix(endings[-1]))
            parts = [layouts.get(whole.part(ending)) for ending in endings]
            if all(part and part.requested for part in parts):
                yield whole
