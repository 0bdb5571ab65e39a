"""Decides which messages of a topic may pass, from the type hashes that its peers announce."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Mapping

from shmgen.bridge.codec.type_identity import Identity
from shmgen.bridge.common.support import remember_bounded


class Peers:
    """The present peers of a topic or service, and former peers with messages still in the queue. Thread-safe."""

    def __init__(
        self,
        identity: Identity,
        on_incompatible: Callable[[str], None] = lambda why: None,
        hashes: Callable[[], Mapping[bytes, str]] = dict,
    ) -> None:
        """Compare the type hashes of peers by `identity`.

        * `on_incompatible` is called with the reason why a peer is incompatible, and with `""` once all are compatible.
        * `hashes`, for look(), returns the type hash of each peer in the graph.
        """
        self._identity, self._on_incompatible, self._hashes = identity, on_incompatible, hashes
        self._present: dict[Hashable, str] = {}
        self._departed: dict[Hashable, str] = {}
        self._reported = ""
        self._lock = threading.Lock()

    def add(self, peer: Hashable, announced: str) -> None:
        """Add a present peer that announces the type hash `announced`."""
        self._present[peer] = self._identity.refusal(announced)
        self._report()

    def remove(self, peer: Hashable) -> None:
        """Remove a peer that has left."""
        if (why := self._present.pop(peer, None)) is not None:
            remember_bounded(self._departed, peer, why)
        self._report()

    def look(self) -> None:
        """Read the present peers and their type hashes from the graph."""
        with self._lock:
            present = self._hashes()
            for peer in self._present.keys() - present.keys():
                self.remove(peer)
            for peer, announced in present.items():
                self.add(peer, announced)

    def forget(self) -> None:
        """Forget the peers that have left. Call this method when no message is in the queue."""
        self._departed.clear()

    def knows(self, peer: Hashable) -> bool:
        return peer in self._present or peer in self._departed

    def refusal(self, peer: Hashable = None) -> str:
        """Return why a message of `peer` must be refused, or `""`.

        If the sender is unknown, `peer` is None. Then refuse the message if any peer is incompatible.
        """
        if peer is None:
            return self.incompatible_peer or _first(self._departed)
        unknown = "" if self._identity.accepts_other else "a peer left before its type could be compared"
        return self._present.get(peer, self._departed.get(peer, unknown))

    @property
    def has_compatible(self) -> bool:
        """True if any present peer uses a compatible type."""
        return "" in tuple(self._present.values())

    @property
    def incompatible_peer(self) -> str:
        """The reason why a present peer is incompatible, or `""` if all are compatible."""
        return _first(self._present)

    def _report(self) -> None:
        if (why := self.incompatible_peer) != self._reported:
            self._reported = why
            self._on_incompatible(why)


def _first(reasons: Mapping[Hashable, str]) -> str:
    return next(filter(None, tuple(reasons.values())), "")
