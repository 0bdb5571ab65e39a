"""Decides from the ROS graph whether messages of the peers of a topic may pass.

Fast DDS adds a peer to the graph before the peer can send to the bridge, and removes the peer when it leaves. Messages
of the peer may then still wait in the queue. An incompatible peer that has left is therefore remembered until the queue
is empty.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from shmgen.bridge.codec.type_identity import Identity

Hashes = Callable[[], dict[bytes, str]]
"""A function that returns the GID and the announced type hash of each peer in the graph."""

_UNKNOWN = "a peer left before its type could be compared"


class Peers:
    """Checks whether the peers of a topic or service use a compatible type. Thread-safe."""

    def __init__(
        self, identity: Identity, hashes: Hashes, on_incompatible: Callable[[str], None] = lambda why: None
    ) -> None:
        """Prepare the check of peers by `identity`, which compares their type hashes. `hashes` returns these hashes.

        Each call of `look` calls `on_incompatible` with the reason why a peer is incompatible, or with `""` if all are
        compatible.
        """
        self._identity = identity
        self._hashes = hashes
        self._on_incompatible = on_incompatible
        self._unknown = "" if identity.accepts_other else _UNKNOWN
        self._present: dict[bytes, str] = {}
        self._departed: dict[bytes, str] = {}
        self._lock = threading.Lock()

    def look(self) -> None:
        """Read the present peers and their type hashes from the graph."""
        with self._lock:
            before = self._present
            self._present = {gid: self._identity.refusal(hash_) for gid, hash_ in self._hashes().items()}
            self._departed |= {gid: why for gid, why in before.items() if gid not in self._present}
        self._on_incompatible(next(filter(None, self._present.values()), ""))

    def knows(self, gid: bytes) -> bool:
        return gid in self._present or gid in self._departed

    def refusal(self, gid: bytes = b"") -> str:
        """Return why a message of the peer `gid` must be refused, or `""` if the message may pass.

        If `gid` is empty, the sender is unknown: refuse the message if any peer is incompatible.
        """
        present, departed = self._present, self._departed
        if gid:
            return present.get(gid, departed.get(gid, self._unknown))
        return next((why for why in (*present.values(), *departed.values()) if why), "")

    def forget(self) -> None:
        """Forget the peers that have left. Call this method when no message of theirs waits in the queue."""
        if self._departed:
            with self._lock:
                self._departed = {}
