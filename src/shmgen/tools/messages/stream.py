"""Follows a topic: yields the samples of its region, and after a removal the samples of the next region."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing

from shmgen.core.plural import counted
from shmgen.live.classes import ClassRegistry, watcher
from shmgen.live.regions import View, missing, sound
from shmgen.runtime import Message, Sample, Subscriber, region_name
from shmgen.runtime.errors import RegionMissing
from shmgen.runtime.region import header as h

POLL = 1e-3
"""Seconds between two polls of a region."""
_POLL_MISSING = 0.05

Tell = Callable[[str], None]
"""A function that receives a note for the user at the terminal."""


def messages(topic: str, registry: ClassRegistry, timeout: float | None, tell: Tell) -> Generator[Message, None, None]:
    """Yield all messages of a topic, beginning with the newest existing message, until the caller closes the generator.

    Wait for the region if it does not exist yet, and for a new region after a removal. Raises TimeoutError after
    `timeout` seconds without a sample, and the errors of Subscriber and ClassRegistry.message().
    """
    with closing(regions(topic, registry, timeout, tell, passive=False)) as followed_regions:
        for view, reader in followed_regions:
            try:
                for samples in batches(topic, view, reader, timeout):
                    for sample in samples:
                        yield sample.message
            finally:
                if reader.missed:
                    tell(f"{topic}: {counted(reader.missed, 'sample')} overwritten before this program could read them")


def regions(
    topic: str, registry: ClassRegistry | None, timeout: float | None, tell: Tell, *, passive: bool = True
) -> Generator[tuple[View, Subscriber[Message]], None, None]:
    """Yield a view and a subscriber of the topic's region. If the region is removed, repeat with the next region.

    Without `registry`, messages have no fields. `passive` is passed to Subscriber. Raises the errors of messages().
    """
    while True:
        with wait_for_region(topic, timeout, tell) as view:
            header = sound(view)
            kind = registry.message(header.type_name, header.digest) if registry else None
            with watcher(view, kind, passive=passive) as reader:
                yield view, reader
        tell(f"{topic}: the region was removed; waiting for a new one")


def batches(
    topic: str, view: View, reader: Subscriber[Message], timeout: float | None
) -> Iterator[list[Sample[Message]]]:
    """Yield the new samples of a region each millisecond, until the region is removed. The list may be empty.

    Raises TimeoutError after `timeout` seconds without a sample.
    """
    last_sample_at = time.monotonic()
    while not view.removed:
        samples = reader.samples()
        yield samples
        if samples:
            last_sample_at = time.monotonic()
        else:
            _give_up(topic, last_sample_at, timeout, "no sample")
            time.sleep(POLL)


def wait_for_region(topic: str, timeout: float | None, tell: Tell) -> View:
    """Wait until the topic's region has a header, and return the region. Pass a note to `tell` before a wait.

    Raises TimeoutError after `timeout` seconds, PermissionDenied, and RegionUnusable if the file is not a region.
    """
    name = region_name(topic)
    begun = time.monotonic()
    is_waiting_shown = False
    while True:
        try:
            view = View(name)
        except RegionMissing:
            pass
        else:
            if view.header().magic == h.MAGIC:
                return view
            view.close()
        if not is_waiting_shown:
            tell(f"{missing(topic)}\nwaiting for it")
            is_waiting_shown = True
        _give_up(topic, begun, timeout, "no region")
        time.sleep(_POLL_MISSING)


def _give_up(topic: str, since: float, timeout: float | None, what: str) -> None:
    if timeout is not None and time.monotonic() - since > timeout:
        raise TimeoutError(f"{topic}: {what} within {timeout:g} s; see `shmgen doctor {topic}`")
