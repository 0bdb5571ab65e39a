"""Chooses the library for services: shmgen-fastdds, which reaches all of ROS 2, or Cyclone."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from typing import Any, cast

from cyclonedds.core import DDSException
from cyclonedds.sub import DataReader

from shmgen.bridge.backend import QUEUE, Node
from shmgen.bridge.common import qos
from shmgen.bridge.dds.entities import Ends, ReaderThread, Subscription, key_of, matches, quality, send, user_data_of
from shmgen.bridge.dds.network import Network
from shmgen.bridge.dds.service_pair import Direction, OnPeerDiscovered, Pair, ReceivedCall, ServiceTransport

_BOUNDS = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
)
"""Environment variables that restrict the network of Fast DDS."""


def chosen(ends: Ends, node: Node, domain: int, network: Network, environment: Mapping[str, str]) -> ServiceTransport:
    """Choose the library for services. Prefer Fast DDS if it can obey the network restrictions."""
    if environment.get("RMW_IMPLEMENTATION") == "rmw_cyclonedds_cpp" or network.reach == "OFF":
        return Cyclone(ends, "")
    if environment.get("CYCLONEDDS_URI") and not any(map(environment.get, _BOUNDS)):
        return Cyclone(ends, f"set {_BOUNDS[0]} or {_BOUNDS[-1]}, because Fast DDS ignores CYCLONEDDS_URI")
    try:
        from shmgen_fastdds import Fast
    except ImportError:
        return Cyclone(ends, "install shmgen-fastdds where the bridge runs (docs/bridge.md, DDS without ROS)")
    try:
        return Fast(node, domain, network)
    except OSError as error:
        return Cyclone(ends, f"install shmgen-fastdds again ({error})")


class CyclonePair(Pair):
    """The reader and the writer of one service in Cyclone DDS. A peer is identified by its Cyclone handle."""

    def __init__(self, ends: Ends, reads: Direction, writes: Direction, on_peer: OnPeerDiscovered) -> None:
        super().__init__(on_peer)
        self._ends = ends
        self._ours: dict[bool, Any] = {}
        self._ours[False] = self._writer = ends.writer(writes.topic, writes.kind, _quality(writes), self._matched_now)
        self._ours[True] = self._reader = ends.reader(reads.topic, reads.kind, _quality(reads), self._matched_now)
        for is_writer in (True, False):  # peers that matched before both entities existed
            self.peers(is_writer)

    def _matched_now(self, entity: Any, handle: int, is_there: bool) -> None:
        if is_there:
            with suppress(LookupError):
                self._user_data_of(key_of(handle), isinstance(entity, DataReader))

    def _matched(self, is_writer: bool) -> list[Hashable]:
        with suppress(DDSException):  # the bridge has closed the entities
            return [key_of(handle) for handle in matches(self._ours[is_writer])]
        return []

    def _read_user_data(self, peer: Hashable, is_writer: bool) -> list[str]:
        return user_data_of(self._ours[is_writer], cast(int, peer))

    def send(self, cdr: bytes, call: bytes | None = None) -> bytes:
        with suppress(DDSException):  # the bridge has closed the entities
            send(self._writer, cdr)
        return b""

    def close(self) -> None:
        self._thread.stop()
        for entity in self._ours.values():
            entity.__del__()

    def listen(self, callback: Callable[[ReceivedCall], None], name: str) -> None:
        def take(sample: Any) -> None:
            sender = key_of(sample.sample_info.publication_handle)
            callback(ReceivedCall(sample.cdr, self._user_data_of(sender, True), sender))

        self._thread = ReaderThread(self._ends, name)
        self._thread.add(Subscription(self._reader, take, name))


class Cyclone:
    """Creates the readers and writers of services in Cyclone DDS, as a ServiceTransport."""

    inline = False

    def __init__(self, ends: Ends, why: str) -> None:
        self._ends, self.why = ends, f"{why}, or " if why else ""

    def pair(self, reads: Direction, writes: Direction, on_peer: OnPeerDiscovered) -> Pair:
        """Create the reader and the writer of one service. Ends.close() closes both."""
        return CyclonePair(self._ends, reads, writes, on_peer)

    def leave(self) -> None:
        """Do nothing, because Ends.close() leaves the domain."""


def _quality(side: Direction) -> Any:
    return quality(qos.Qos(reliable=True, latched=False), QUEUE, side.words)
