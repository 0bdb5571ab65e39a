"""What services.py asks of DDS: for each service a reader and a writer, and who is at the other end of the two."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from shmgen.bridge.backend import keep

Met = Callable[[list[str], bool], None]
"""Is called with the words in the user data of a peer, and whether it is one that we hear; once for each."""


class Side(NamedTuple):
    """A topic of DDS, its type's name and Cyclone's structure of it, and what our end of it has in its user data."""

    topic: str
    type_name: str
    kind: type[Any]
    words: str


@dataclass(frozen=True, slots=True)
class Came:
    """A request or a reply, encapsulation included, and the words in the user data of its sender.

    `call` says whose call it is, of a sender that says it inline.
    """

    cdr: bytes
    words: list[str]
    sender: Hashable
    call: bytes = b""


class Pair(ABC):
    """A reader and a writer. Its methods may be called from any thread."""

    def __init__(self, met: Met) -> None:
        self._met = met
        self._words: dict[Hashable, list[str]] = {}
        self._meeting = threading.Lock()

    def peers(self, heard: bool) -> dict[Hashable, list[str]]:
        """Those that we hear, or those that hear us, and the words in their user data."""
        found = {}
        for peer in self._matched(heard):
            with suppress(LookupError):  # gone meanwhile
                found[peer] = self._words_of(peer, heard)
        return found

    def _words_of(self, peer: Hashable, heard: bool) -> list[str]:
        """Also of one that has gone, if it was met not long ago. Raises LookupError."""
        with self._meeting:
            if peer in self._words:
                return self._words[peer]
            words = self._said(peer, heard)
            keep(self._words, peer, words)
        self._met(words, heard)
        return words

    @abstractmethod
    def _matched(self, heard: bool) -> list[Hashable]:
        """Those of whom `peers` tells."""

    @abstractmethod
    def _said(self, peer: Hashable, heard: bool) -> list[str]:
        """The words in its user data. Raises LookupError if it has gone."""

    @abstractmethod
    def send(self, cdr: bytes, call: bytes | None = None) -> bytes:
        """An inline reply goes to a `call`; of an inline request it gives what its reply is known by."""

    @abstractmethod
    def close(self) -> None:
        """Leaves the graph."""

    @abstractmethod
    def listen(self, callback: Callable[[Came], None], name: str) -> None:
        """Calls back with whatever comes, in order, in a thread of its own."""


class ServiceTransport(Protocol):
    """How services are had."""

    inline: bool
    """Whether it can say beside the bytes whose call they are, as rmw_fastrtps has it."""
    why: str
    """If not, what to do for it: the beginning of a sentence."""

    def pair(self, hears: Side, says: Side, met: Met) -> Pair:
        """Raises ValueError where it cannot be had."""

    def leave(self) -> None:
        """For good; waits for nobody."""
