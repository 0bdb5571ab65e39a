"""Follows a topic: the samples that come, from its region of now and from those that follow it."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing

from shmgen.core.plural import counted
from shmgen.live.classes import ClassRegistry, watcher
from shmgen.live.regions import View, missing, sound
from shmgen.runtime import Message, Sample, Subscriber, region_name
from shmgen.runtime.errors import RegionMissing, RegionUnusable
from shmgen.runtime.region import header as h

POLL = 1e-3
"""Seconds between two looks."""
_POLL_MISSING = 0.05

Tell = Callable[[str], None]
"""Takes a note for whoever sits at the terminal."""


def messages(topic: str, registry: ClassRegistry, timeout: float | None, tell: Tell) -> Generator[Message, None, None]:
    """Each message, the newest that is there already first; ends only by an error, or when it is closed.

    Waits for a region that does not exist yet, and for the next one when it is removed. Raises TimeoutError
    after `timeout` seconds without a sample, and what a Subscriber and ClassRegistry.message() raise.
    """
    with closing(regions(topic, registry, timeout, tell, passive=False)) as found:
        for view, reader in found:
            try:
                for taken in looks(topic, view, reader, timeout):
                    for sample in taken:
                        yield sample.message
            finally:
                if reader.missed:
                    tell(f"{topic}: {counted(reader.missed, 'sample')} overwritten before they could be read here")


def regions(
    topic: str, registry: ClassRegistry | None, timeout: float | None, tell: Tell, *, passive: bool = True
) -> Generator[tuple[View, Subscriber[Message]], None, None]:
    """The topic's region and what reads it, and after its end the next; without `registry` messages have no fields.

    Raises as messages().
    """
    while True:
        with appeared(topic, timeout, tell) as view:
            header = sound(view)
            kind = registry.message(header.type_name, header.digest) if registry else None
            with watcher(view, kind, passive=passive) as reader:
                yield view, reader
        tell(f"{topic}: the region was removed; waiting for a new one")


def looks(
    topic: str, view: View, reader: Subscriber[Message], timeout: float | None
) -> Iterator[list[Sample[Message]]]:
    """What has come, each millisecond, also nothing, until the region is removed. Raises TimeoutError."""
    heard = time.monotonic()
    while not view.removed:
        taken = reader.samples()
        yield taken
        if taken:
            heard = time.monotonic()
        else:
            _give_up(topic, heard, timeout, "no sample")
            time.sleep(POLL)


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
