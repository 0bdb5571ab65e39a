"""Turns what is installed and said here into the way that services are had: by Fast DDS, or else by Cyclone."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping

from cyclonedds.core import DDSException

from shmgen.bridge.backend import Node
from shmgen.bridge.dds import fastdds_library
from shmgen.bridge.dds.cyclone_service import Cyclone
from shmgen.bridge.dds.entities import Ends
from shmgen.bridge.dds.fastdds_service import Fast
from shmgen.bridge.dds.network import Network
from shmgen.bridge.dds.service_pair import ServiceTransport

_BOUNDS = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
)
"""What says where Fast DDS may go."""
_FAREWELL = 0.3
"""Seconds that the end of services may take."""


class ServiceTransports:
    """Chooses once, in a thread of its own: to compile takes seconds, and topics do not wait for it."""

    def __init__(self, choose: Callable[[Callable[[], bool]], ServiceTransport], tell: Callable[[str], None]) -> None:
        """`choose` is given what tells whether it need not go on."""
        self._choose, self._tell = choose, tell
        self._asked: queue.SimpleQueue[Callable[[ServiceTransport], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="services", daemon=True)
        self._ended = threading.Event()
        self._begun = False

    def opened(self, then: Callable[[ServiceTransport], None]) -> None:
        """Calls it as soon as it is known, one after the other. From one thread."""
        self._asked.put(then)
        if not self._begun:
            self._begun = True
            self._thread.start()

    def leave(self) -> None:
        """Ends all services of Fast DDS."""
        self._ended.set()
        self._asked.put(None)
        if self._begun:
            self._thread.join(_FAREWELL)

    def _run(self) -> None:
        way = self._choose(self._ended.is_set)
        try:
            while (then := self._asked.get()) and not self._ended.is_set():
                try:
                    then(way)
                except (DDSException, OSError) as error:
                    if not self._ended.is_set():
                        self._tell(f"dds: {error}")
        finally:
            way.leave()


def chosen(
    ends: Ends, node: Node, domain: int, network: Network, environment: Mapping[str, str], ended: Callable[[], bool]
) -> ServiceTransport:
    """Fast DDS reaches all of ROS 2, but goes nowhere that Cyclone was told not to go."""
    if environment.get("RMW_IMPLEMENTATION") == "rmw_cyclonedds_cpp" or network.reach == "OFF":
        return Cyclone(ends, "")
    if environment.get("CYCLONEDDS_URI") and not any(map(environment.get, _BOUNDS)):
        return Cyclone(
            ends, f"CYCLONEDDS_URI says nothing to Fast DDS, which reaches it: set {_BOUNDS[0]} or {_BOUNDS[-1]}"
        )
    try:
        return Fast(fastdds_library.load(node.tell, ended), domain, node.name, network, node.largest, node.tell)
    except (fastdds_library.Missing, OSError) as error:
        return Cyclone(ends, str(error))
