"""Builds the request of a service call from values that a user types."""

from __future__ import annotations

import re
from typing import Any

from shmgen.core.diagnostics import Rejected
from shmgen.live.classes import ClassRegistry, call_class
from shmgen.runtime import Message, ServiceClient
from shmgen.tools.messages import parse

_TYPE = re.compile(r"([A-Za-z]\w*)/(?:srv/)?([A-Za-z]\w*)", re.ASCII)


def build(
    service: str, type_name: str, data: Any, registry: ClassRegistry
) -> tuple[Message, type[ServiceClient[Any, Any]]]:
    """Return the request with the values in `data`, and the client class with which to call the service.

    Raises ValueError and Rejected if the type is invalid, and LayoutMismatch if the region has another layout. Raises
    ValueRejected with the path of the field if a value does not fit.
    """
    parts = _TYPE.fullmatch(type_name)
    if parts is None:
        raise ValueError(f"{type_name} is not a service type: write package/Name")
    full_name = f"{parts[1]}/srv/{parts[2]}"
    try:
        request, _ = registry.message_of_topic(f"{service}-request", f"{full_name}_Request", full_name)
        reply, _ = registry.message_of_topic(f"{service}-response", f"{full_name}_Reply", full_name)
    except Rejected:
        if f"{parts[1]}/msg/{parts[2]}" in map(str, registry.session.library.known()):
            raise ValueError(f"{type_name} is a message, not a service; `shmgen pub` publishes it") from None
        raise
    return parse.build(request, data), call_class(ServiceClient, {"_Request": request, "_Reply": reply})
