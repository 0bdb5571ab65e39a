"""Whether what the peers of a topic send may pass, by what the graph says of them.

Fast DDS tells the graph of a peer before it pairs it with an end of ours, and takes it away when it goes; but what the
peer has sent by then still waits to be taken. So one of another definition counts until all of that has been taken.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from shmgen.bridge.codec.type_identity import Identity

Hashes = Callable[[], dict[bytes, str]]
"""Of each peer that the graph knows of now, its GID and the type hash that it announces."""

_UNKNOWN = "a peer has gone before it could be asked what it means by the type"


class Peers:
    """Who of them means by the type what we do. Its methods may be called from any thread."""

    def __init__(self, identity: Identity, hashes: Hashes, meet: Callable[[str], None] = lambda why: None) -> None:
        """`meet` is told at each look why one that is there may not be heard; nothing, if all may."""
        self._identity = identity
        self._hashes = hashes
        self._meet = meet
        self._unknown = "" if identity.accepts_other else _UNKNOWN
        self._there: dict[bytes, str] = {}
        self._gone: dict[bytes, str] = {}
        self._lock = threading.Lock()

    def look(self) -> None:
        """Who is there now, and means what."""
        with self._lock:
            before = self._there
            self._there = {gid: self._identity.refusal(hash_) for gid, hash_ in self._hashes().items()}
            self._gone |= {gid: why for gid, why in before.items() if gid not in self._there}
        self._meet(next(filter(None, self._there.values()), ""))

    def knows(self, gid: bytes) -> bool:
        return gid in self._there or gid in self._gone

    def refusal(self, gid: bytes = b"") -> str:
        """Why what this one has sent may not pass; why nothing may, where it is not known who sent it."""
        there, gone = self._there, self._gone
        if gid:
            return there.get(gid, gone.get(gid, self._unknown))
        return next((why for why in (*there.values(), *gone.values()) if why), "")

    def forget(self) -> None:
        """Those who have gone: all that they sent has been taken."""
        if self._gone:
            with self._lock:
                self._gone = {}
