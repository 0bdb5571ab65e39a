"""Turns a topic into the samples that come, from its region of now and from those that follow it."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator

from shmgen.core.plural import counted
from shmgen.live.classes import ClassRegistry, subscriber
from shmgen.live.regions import View, depth_of, missing, sound
from shmgen.runtime import Message, region_name
from shmgen.runtime.errors import RegionMissing, RegionUnusable
from shmgen.runtime.region import header as h

POLL = 1e-3
"""Seconds between two looks. A reader that waits would take the wake-up away from the one it is meant for."""
_POLL_MISSING = 0.05

Tell = Callable[[str], None]
"""Takes a note for whoever sits at the terminal."""


def samples(topic: str, registry: ClassRegistry, timeout: float | None, tell: Tell) -> Generator[Message, None, None]:
    """Each sample, the newest that is there already first; ends only by an error, or when it is closed.

    Waits for a region that does not exist yet, and for the next one when it is removed. Raises TimeoutError
    after `timeout` seconds without a sample, and what a Subscriber and ClassRegistry.message() raise.
    """
    while True:
        with appeared(topic, timeout, tell) as view:
            header = sound(view)
            kind = registry.message(header.type_name, header.digest)
            with subscriber(kind, topic, depth_of(header)) as reader:
                heard = time.monotonic()
                try:
                    while not view.removed:
                        got = reader.read_all()
                        yield from got
                        if got:
                            heard = time.monotonic()
                            continue
                        _give_up(topic, heard, timeout, "no sample")
                        time.sleep(POLL)
                finally:
                    if reader.missed:
                        tell(f"{topic}: {counted(reader.missed, 'sample')} overwritten before they could be read here")
        tell(f"{topic}: the region was removed; waiting for a new one")


def appeared(topic: str, timeout: float | None, tell: Tell) -> View:
    """The topic's region, as soon as there is one with a header.

    Raises TimeoutError, PermissionDenied, and RegionUnusable for what is no region or a damaged one.
    """
    name = region_name(topic)
    begun = time.monotonic()
    told = False
    while True:
        try:
            view = View(name)
        except RegionMissing:
            pass
        else:
            if view.header().magic == h.MAGIC:
                try:
                    sound(view)
                except RegionUnusable:
                    view.close()
                    raise
                return view
            view.close()
        if not told:
            tell(f"{missing(topic)}\nwaiting for it")
            told = True
        _give_up(topic, begun, timeout, "no region")
        time.sleep(_POLL_MISSING)


def _give_up(topic: str, since: float, timeout: float | None, what: str) -> None:
    if timeout is not None and time.monotonic() - since > timeout:
        raise TimeoutError(f"{topic}: {what} within {timeout:g} s; see `shmgen doctor {topic}`")
