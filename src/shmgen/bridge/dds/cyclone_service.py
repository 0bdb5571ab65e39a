"""One service as a reader and a writer of Cyclone."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import suppress
from typing import Any, cast

from cyclonedds.core import DDSException
from cyclonedds.sub import DataReader

from shmgen.bridge.backend import QUEUE
from shmgen.bridge.dds.entities import Ends, matches, quality, said_by, send
from shmgen.bridge.dds.service_pair import Came, Met, Pair, Side


class CyclonePair(Pair):
    """Peers go by their handles."""

    def __init__(self, ends: Ends, hears: Side, says: Side, met: Met) -> None:
        super().__init__(met)
        self._ends = ends
        self._ours: dict[bool, Any] = {}
        self._ours[False] = self._writer = ends.writer(says.topic, says.kind, _quality(says), self._matched_now)
        self._ours[True] = self._reader = ends.reader(hears.topic, hears.kind, _quality(hears), self._matched_now)
        for heard in (True, False):  # those of whom nobody was told while they were made
            self.peers(heard)

    def _matched_now(self, entity: Any, handle: int, is_there: bool) -> None:
        if is_there:
            with suppress(LookupError):
                self._words_of(_key(handle), isinstance(entity, DataReader))

    def _matched(self, heard: bool) -> list[Hashable]:
        with suppress(DDSException):  # the bridge has ended meanwhile
            return [_key(handle) for handle in matches(self._ours[heard])]
        return []

    def _said(self, peer: Hashable, heard: bool) -> list[str]:
        return said_by(self._ours[heard], cast(int, peer))

    def send(self, cdr: bytes, call: bytes | None = None) -> bytes:
        with suppress(DDSException):  # the bridge has ended meanwhile
            send(self._writer, cdr)
        return b""

    def close(self) -> None:
        self._unheard()
        for entity in self._ours.values():
            entity.__del__()

    def listen(self, callback: Callable[[Came], None], name: str) -> None:
        def take(sample: Any) -> None:
            sender = _key(sample.sample_info.publication_handle)
            callback(Came(sample.cdr, self._words_of(sender, True), sender))

        self._unheard = self._ends.listen(self._reader, take, name)


class Cyclone:
    """A ServiceTransport."""

    inline = False

    def __init__(self, ends: Ends, why: str) -> None:
        self._ends, self.why = ends, f"{why}, or " if why else ""

    def pair(self, hears: Side, says: Side, met: Met) -> Pair:
        """Its ends go with all others."""
        return CyclonePair(self._ends, hears, says, met)

    def leave(self) -> None:
        """Ends.close() does."""


def _key(handle: int) -> int:
    """Cyclone's Python gives the same handle with a sign, and without."""
    return handle % 2**64


def _quality(side: Side) -> Any:
    return quality("reliable", False, QUEUE, side.words)
