"""Builds the request of a service call from values that a user types."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any

from shmgen.core.diagnostics import Rejected
from shmgen.live.classes import ClassRegistry, client
from shmgen.live.regions import View
from shmgen.runtime import Message, ServiceClient, region_name
from shmgen.runtime.errors import RegionMissing
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
        raise ValueError(f"{type_name} names no service: write package/Name")
    try:
        request, reply = (
            _message(f"{service}-{half}", f"{parts[1]}/srv/{parts[2]}", ending, registry)
            for half, ending in (("request", "_Request"), ("response", "_Reply"))
        )
    except Rejected:
        if f"{parts[1]}/msg/{parts[2]}" in map(str, registry.session.library.known()):
            raise ValueError(f"{type_name} is a message, not a service; `shmgen pub` publishes it") from None
        raise
    return parse.build(request, data), client(request, reply)


def _message(topic: str, service: str, ending: str, registry: ClassRegistry) -> type[Message]:
    """Return the class of the request or the reply of a service.

    `service` is the service type, and `ending` is the ending of the message's type name, such as "_Request". If the
    region `topic` exists and contains messages of this type, the class has the layout of the region.
    """
    type_name = service + ending
    with suppress(RegionMissing), View(region_name(topic)) as view:
        header = view.header()
        if header.type_name == type_name:
            return registry.message(type_name, header.digest, service)
    return registry.message(type_name, part_of=service)
