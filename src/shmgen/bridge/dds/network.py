"""Builds Cyclone's configuration from the discovery variables of ROS 2 and from the largest message.

Source: rcl (discovery_options.c) and rmw_cyclonedds, Iron and later. For each value of ROS_AUTOMATIC_DISCOVERY_RANGE,
Cyclone gets the same configuration as from rmw_cyclonedds.
"""

from __future__ import annotations

import ctypes
import os
import socket
import stat
import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

_RANGES = ("OFF", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT")
_PACKETS = "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>64000B</FragmentSize>"
"""Packets as large as those of Fast DDS, which is nearly the maximum of UDP.

Cyclone divides a message of 1 MiB into 780 fragments of 1,344 bytes. A node on Fast DDS 2.14 or 3.2 that was too slow
for them read empty samples forever (5 of 5 runs of tests/ros2/test_large.py on a busy machine).
"""
_PROCESSES = 32
"""Maximum number of processes on one machine that are found without multicast. rmw_cyclonedds uses the same."""


@dataclass(frozen=True, slots=True)
class Network:
    """The network settings of a DDS domain.

    `config` is Cyclone's XML, `alone` is True if only this machine is reachable, and `notes` are lines to log. `reach`
    is the effective discovery range, or `""` for the default. `peers` are the effective static peers.
    """

    config: str
    alone: bool
    notes: tuple[str, ...]
    reach: str
    peers: tuple[str, ...]


def network(environment: Mapping[str, str], largest: int) -> Network:
    """Return the network settings from the environment.

    Use ROS_LOCALHOST_ONLY, ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS. CYCLONEDDS_URI overrides all three.
    Cyclone drops a message of more than `largest` bytes at its first fragment and logs the drop on stderr.
    """
    discovery_range = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    peers = [peer.strip() for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer.strip()]
    reach, notes = discovery_range or ("SUBNET" if peers else ""), []
    if environment.get("ROS_LOCALHOST_ONLY") == "1":
        if discovery_range or peers:
            notes.append("ROS_LOCALHOST_ONLY is 1: ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS are ignored")
        reach, peers = "LOCALHOST", []
    elif discovery_range and discovery_range not in _RANGES:
        notes.append(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE is {discovery_range!r}, not one of {', '.join(_RANGES)}: using LOCALHOST"
        )
        reach = "LOCALHOST"
    if reach in ("OFF", "SYSTEM_DEFAULT") and peers:
        notes.append(f"ROS_STATIC_PEERS is ignored with ROS_AUTOMATIC_DISCOVERY_RANGE={reach}")
        peers = []
    alone = reach in ("OFF", "LOCALHOST") and not peers
    sizes = f"<Internal><MaxSampleSize>{largest}B</MaxSampleSize></Internal>"
    ours = f'<CycloneDDS><Domain Id="any">{sizes}{_discovery(reach, peers)}</Domain></CycloneDDS>'
    if alone:
        notes.append(
            "the bridge reaches only this machine"
            if reach == "LOCALHOST"
            else "discovery is off: the bridge and other processes do not find each other"
        )
    return Network(
        ",".join(filter(None, (ours, environment.get("CYCLONEDDS_URI")))), alone, tuple(notes), reach, tuple(peers)
    )


def _discovery(reach: str, peers: list[str]) -> str:
    general = f"<General>{_PACKETS}</General>"
    silent = f"<General>{_PACKETS}<AllowMulticast>false</AllowMulticast></General>"
    if reach == "OFF":  # a unique tag: no other process can match it
        tag = f"<Tag>ros_discovery_off_{os.getpid()}</Tag>"
        return f"{silent}<Discovery><ParticipantIndex>none</ParticipantIndex>{tag}</Discovery>"
    if reach in ("", "SYSTEM_DEFAULT"):
        return general
    addresses = [*(["localhost"] if reach == "LOCALHOST" else []), *peers]
    named = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in addresses)
    most = f"<MaxAutoParticipantIndex>{_PROCESSES}</MaxAutoParticipantIndex>"
    index = f"<ParticipantIndex>auto</ParticipantIndex>{most}"
    discovery = f"<Discovery>{index}{f'<Peers>{named}</Peers>' if named else ''}</Discovery>"
    return (silent if reach == "LOCALHOST" else general) + discovery


def sockets() -> set[int]:
    """Return the file descriptors of all open sockets of this process."""
    descriptors = set()
    for name in os.listdir("/proc/self/fd"):
        with suppress(OSError):  # the descriptor of listdir itself is closed already
            if stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                descriptors.add(int(name))
    return descriptors


def confine(before: set[int]) -> None:
    """Limit all UDP sockets except `before` to packets from this machine. Raises OSError if the kernel refuses.

    Cyclone binds its sockets to all interfaces. A kernel filter therefore drops packets that did not arrive on `lo`.
    Packets between processes of one machine always arrive on `lo`, whatever address they use.
    """
    only_lo = (
        (_LOAD, 0, 0, _INTERFACE),
        (_JUMP_IF_EQUAL, 0, 1, socket.if_nametoindex("lo")),
        (_RETURN, 0, 0, 0xFFFFFFFF),
        (_RETURN, 0, 0, 0),
    )
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *step) for step in only_lo))
    program = struct.pack("@HP", len(only_lo), ctypes.addressof(code))
    for descriptor in sockets() - before:
        with socket.socket(fileno=os.dup(descriptor)) as opened_socket:
            if opened_socket.type == socket.SOCK_DGRAM and opened_socket.family in (socket.AF_INET, socket.AF_INET6):
                opened_socket.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, program)


_SO_ATTACH_FILTER = 26
_LOAD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06
"""Instructions of classic BPF."""
_INTERFACE = 0xFFFFF008
"""SKF_AD_OFF + SKF_AD_IFINDEX (linux/filter.h): the offset at which a filter loads the interface number."""
