"""The settings with which a publisher or subscriber opens its region, for both engines, in C and in Python."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

from shmgen.core import abi
from shmgen.runtime.region.access import RegionOptions
from shmgen.runtime.region.header import Header, header_for
from shmgen.runtime.region.names import region_name

UNTIL_RECOVERED = (abi.RECOVER_MS + abi.PEER_MS) / 1000
"""Seconds that a writer waits on machines that need the lock. By then the lock is free or recovered."""

_MOST_SPIN = 0.001
"""The maximum of `spin` in seconds."""


class Settings(NamedTuple):
    """The settings of a publisher or subscriber, in the order in which the engine in C reads them.

    * `kind`, `codec`, `size`: the message class, its table for the engine in C or None, and its size in bytes.
    * `lock_ns`: the lock timeout, or -1 for the default. `mode`, `group`: 0 and "" if not set.
    * `sequence`: True for a region without a lock. The other options are parameters of Publisher and Subscriber.
    """

    topic: str
    kind: Any
    codec: Any
    type_name: str
    digest: int
    size: int
    depth: int
    lock_ns: int
    mode: int
    group: str
    sequence: bool
    passive: bool
    history: bool
    reopen: bool
    spin_us: int
    word: str
    """The word for the endpoint in error messages."""
    header: Header
    """The header for a new region."""

    @property
    def options(self) -> RegionOptions:
        return RegionOptions(self.mode or None, self.group or None, "sequence" if self.sequence else "lock")


def settings_for(
    word: str,
    kind: Any,
    topic: str,
    *,
    codec: Any = None,
    depth: int = 1,
    lock_timeout: float | None = None,
    mode: int | None = None,
    group: str | int | None = None,
    passive: bool = False,
    history: bool = False,
    reopen: bool = True,
    spin: float = 0.0,
) -> Settings:
    """Return the settings of a publisher or subscriber of `topic`. `word` is "publisher" or "subscriber".

    Raises ValueError if the topic, the depth, `lock_timeout` or `spin` is invalid.
    """
    if not 0 <= spin <= _MOST_SPIN:
        raise ValueError(f"spin is {spin}, but must be from 0 to {_MOST_SPIN} seconds")
    longest = abi.RECOVER_MS / 1000
    if lock_timeout is not None and not 0 <= lock_timeout <= longest:
        raise ValueError(f"lock_timeout is {lock_timeout}, but must be from 0 to {longest:.0f} second")
    region_name(topic)
    header = header_for(kind._type_name_, kind._digest_, ctypes.sizeof(kind), depth)
    options = kind._regions_.but(mode, group)
    return Settings(
        topic=topic,
        kind=kind,
        codec=codec,
        type_name=header.type_name,
        digest=header.digest,
        size=header.payload_size,
        depth=depth,
        lock_ns=-1 if lock_timeout is None else round(lock_timeout * 1e9),
        mode=options.mode or 0,
        group="" if options.group is None else str(options.group),
        sequence=options.sync == "sequence",
        passive=passive,
        history=history,
        reopen=reopen and not passive,
        spin_us=round(spin * 1e6),
        word=word,
        header=header,
    )
