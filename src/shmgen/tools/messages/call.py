"""Calls a service once, with a person's values."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any

from shmgen.live.classes import ClassRegistry, client
from shmgen.live.regions import View
from shmgen.runtime import Message, ServiceClient, region_name
from shmgen.runtime.errors import RegionMissing
from shmgen.tools.messages import parse

_TYPE = re.compile(r"([A-Za-z]\w*)/(?:srv/)?([A-Za-z]\w*)", re.ASCII)


def build(
    service: str, type_name: str, data: Any, registry: ClassRegistry
) -> tuple[Message, type[ServiceClient[Any, Any]]]:
    """The request with the values of `data`, and the class of a client that can call the service with it.

    Raises ValueError and Rejected for a wrong type, LayoutMismatch, and ValueRejected with the path of the field.
    """
    parts = _TYPE.fullmatch(type_name)
    if parts is None:
        raise ValueError(f"{type_name} names no service: write package/Name")
    request, reply = (
        _message(f"{service}-{half}", f"{parts[1]}/srv/{parts[2]}", ending, registry)
        for half, ending in (("request", "_Request"), ("response", "_Reply"))
    )
    return parse.build(request, data), client(request, reply)


def _message(topic: str, service: str, ending: str, registry: ClassRegistry) -> type[Message]:
    """With the digest of the region, if there is one of that type."""
    type_name = service + ending
    with suppress(RegionMissing), View(region_name(topic)) as view:
        header = view.header()
        if header.type_name == type_name:
            return registry.message(type_name, header.digest, service)
    return registry.message(type_name, part_of=service)
