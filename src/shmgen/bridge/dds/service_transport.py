"""Chooses the library for services: shmgen-fastdds, which reaches all of ROS 2, or Cyclone."""

from __future__ import annotations

from collections.abc import Mapping

from shmgen.bridge.backend import Node
from shmgen.bridge.dds.cyclone_service import Cyclone
from shmgen.bridge.dds.entities import Ends
from shmgen.bridge.dds.network import Network
from shmgen.bridge.dds.service_pair import ServiceTransport

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
        return Cyclone(
            ends, f"CYCLONEDDS_URI says nothing to Fast DDS, which reaches it: set {_BOUNDS[0]} or {_BOUNDS[-1]}"
        )
    try:
        from shmgen_fastdds import Fast
    except ImportError:
        return Cyclone(ends, "install shmgen-fastdds where the bridge runs (docs/bridge.md, DDS without ROS)")
    try:
        return Fast(node, domain, network)
    except OSError as error:
        return Cyclone(ends, f"install shmgen-fastdds again ({error})")
