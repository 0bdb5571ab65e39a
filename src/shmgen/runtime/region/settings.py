"""What an end of a region is opened with, for the engine in C and the one in Python alike."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

from shmgen.core import abi
from shmgen.runtime.region.access import RegionOptions
from shmgen.runtime.region.header import Header, header_for
from shmgen.runtime.region.names import region_name

UNTIL_RECOVERED = (abi.RECOVER_MS + abi.PEER_MS) / 1000
"""Seconds a writer waits where the lock is needed: whatever has become of its holder, it is free or recovered then."""

_MOST_SPIN = 0.001
"""Seconds."""


class Settings(NamedTuple):
    """In the order in which C takes them. `lock_ns` -1: as is usual; `mode` 0 and `group` "": as shmgen.toml says."""

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
    spin_us: int
    word: str
    """What errors call the end."""
    header: Header
    """That of a fresh region."""

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
    spin: float = 0.0,
) -> Settings:
    """Raises ValueError for a topic, a depth or a limit that cannot be."""
    if not 0 <= spin <= _MOST_SPIN:
        raise ValueError(f"spin is {spin}; it goes from 0 to {_MOST_SPIN} seconds")
    longest = abi.RECOVER_MS / 1000
    if lock_timeout is not None and not 0 <= lock_timeout <= longest:
        raise ValueError(f"lock_timeout is {lock_timeout}; it goes from 0 to {longest:.0f} second")
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
        spin_us=round(spin * 1e6),
        word=word,
        header=header,
    )
