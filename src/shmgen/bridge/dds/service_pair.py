"""The interface that services.py requires of a DDS library: a reader and a writer for each service, and their peers."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from shmgen.bridge.common.support import remember_bounded
from shmgen.bridge.dds.entities import entries_of

OnPeerDiscovered = Callable[[dict[str, str], bool], None]
"""A callback for each new peer: the entries of its user data, and True if the peer is a writer, False if a reader."""


class Direction(NamedTuple):
    """The DDS topic of a service's requests, or of its responses.

    `kind` is Cyclone's structure of a sample. `words` is the user data of the bridge's reader or writer on this topic.
    """

    topic: str
    type_name: str
    kind: type[Any]
    words: str


@dataclass(frozen=True, slots=True)
class ReceivedCall:
    """A received request or reply of a service: its bytes `cdr`, with the encapsulation header, and its sender.

    `words` are the entries in the user data of the sender. `call` is the identity of the call if the sender
    passes this identity inline, as metadata of the sample. If the bytes contain the identity, `call` is empty.
    """

    cdr: bytes
    words: dict[str, str]
    sender: Hashable
    call: bytes = b""


class Pair(ABC):
    """The reader and the writer by which the bridge serves or calls one service. Thread-safe."""

    def __init__(self, on_peer: OnPeerDiscovered) -> None:
        self._on_peer = on_peer
        self._words: dict[Hashable, dict[str, str]] = {}
        self._lock = threading.Lock()

    def peers(self, is_writer: bool) -> dict[Hashable, dict[str, str]]:
        """Return each peer of this service with its user data: writers if `is_writer` is True, or else readers."""
        present = {}
        for peer in self._matched(is_writer):
            with suppress(LookupError):  # the peer has left meanwhile
                present[peer] = self._user_data_of(peer, is_writer)
        return present

    def _user_data_of(self, peer: Hashable, is_writer: bool) -> dict[str, str]:
        """Return a peer's user data, which is read once. Call `on_peer` for a new peer. Raises LookupError if gone."""
        with self._lock:
            if peer in self._words:
                return self._words[peer]
            words = entries_of(self._read_user_data(peer, is_writer))
            remember_bounded(self._words, peer, words)
        self._on_peer(words, is_writer)
        return words

    @abstractmethod
    def _matched(self, is_writer: bool) -> list[Hashable]:
        """Return the present peers of this service: their writers if `is_writer` is True, or else their readers."""

    @abstractmethod
    def _read_user_data(self, peer: Hashable, is_writer: bool) -> list[str]:
        """Return the parts of a peer's user data, such as `clientid=1.2`. Raises LookupError if the peer has left."""

    @abstractmethod
    def send(self, cdr: bytes, call: bytes | None = None) -> bytes:
        """Send `cdr`, the bytes of a request or of a reply.

        An inline identity identifies a call in the metadata of a sample, outside of the bytes. Return the inline
        identity of the sent sample, or `b""` if the DDS library does not support inline identities. `call` is the
        inline identity of the request that a reply answers. Omit `call` if `cdr` is a request, or contains an identity.
        """

    @abstractmethod
    def close(self) -> None:
        """Remove the reader and the writer."""

    @abstractmethod
    def listen(self, callback: Callable[[ReceivedCall], None], name: str) -> None:
        """Start a thread that calls `callback` with each received request or reply, in order."""


class ServiceTransport(Protocol):
    """A DDS library by which the bridge serves and calls services."""

    inline: bool
    """True if the library can send the identity of a call as metadata of a sample, as rmw_fastrtps does."""
    why: str
    """The beginning of a sentence: what the user can do to enable inline identities. `""` if there is no advice."""

    def pair(self, reads: Direction, writes: Direction, on_peer: OnPeerDiscovered) -> Pair:
        """Create a reader of `reads` and a writer of `writes`, or raise ValueError. Call `on_peer` for new peers."""

    def leave(self) -> None:
        """Leave the domain permanently, without waiting."""
