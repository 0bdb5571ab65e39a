"""Find the message whose layout has a given digest, as it appears in a region's header."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from shmgen.core.diagnostics import Rejected
from shmgen.live import regions
from shmgen.live.classes import ClassRegistry
from shmgen.live.session import Session
from shmgen.runtime import ShmError


def find(registry: ClassRegistry, digest: int) -> tuple[Session, str] | None:
    """Return the name of the message whose layout has this digest, and the Session with this layout, or None.

    Raises Rejected if the definitions of the configuration cannot be read, or its messages have no layout.
    """
    for name in dict.fromkeys(_likely(registry, digest)):
        with suppress(Rejected, ShmError, ValueError):
            return registry.session_of(name, digest), name
    return None


def _likely(registry: ClassRegistry, digest: int) -> Iterator[str]:
    """Yield names of messages for a search by digest, the most likely first.

    First come messages of live regions and known layouts with this digest, then all other messages.
    """
    for region in regions.live():
        with suppress(ShmError, OSError), regions.View(region) as view:
            header = view.header()
            if header.digest == digest:
                yield header.type_name
    laid_out, _ = registry.known()
    for name, known in laid_out.items():
        if known.digest == digest:
            yield name
    yield from map(str, registry.session.library.known())
