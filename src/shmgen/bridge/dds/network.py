"""Cyclone's configuration, from what ROS 2's environment says of discovery and from the size of our messages.

Source: rcl (discovery_options.c) and rmw_cyclonedds of Iron and later, whose configuration for each range this is.
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
_PROCESSES = 32
"""Of this machine that can be found without multicast; as rmw_cyclonedds has it."""


@dataclass(frozen=True, slots=True)
class Network:
    """How the domain is joined: Cyclone's configuration, whether nobody but this machine is heard, and what to tell.

    `reach` is the discovery range, if one counts, and `peers` are the static ones that do.
    """

    config: str
    alone: bool
    notes: tuple[str, ...]
    reach: str
    peers: tuple[str, ...]


def network(environment: Mapping[str, str], largest: int) -> Network:
    """By ROS_LOCALHOST_ONLY, ROS_AUTOMATIC_DISCOVERY_RANGE, ROS_STATIC_PEERS; CYCLONEDDS_URI has the last word.

    No message of more than `largest` bytes comes in: Cyclone drops it at its first fragment and says so on stderr.
    """
    said = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    peers = [peer.strip() for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer.strip()]
    reach, notes = said or ("SUBNET" if peers else ""), []
    if environment.get("ROS_LOCALHOST_ONLY") == "1":
        if said or peers:
            notes.append(
                "ROS_LOCALHOST_ONLY is 1: ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS count for nothing"
            )
        reach, peers = "LOCALHOST", []
    elif said and said not in _RANGES:
        notes.append(f"ROS_AUTOMATIC_DISCOVERY_RANGE is {said!r}, none of {', '.join(_RANGES)}: LOCALHOST is taken")
        reach = "LOCALHOST"
    if reach in ("OFF", "SYSTEM_DEFAULT") and peers:
        notes.append(f"ROS_STATIC_PEERS counts for nothing with ROS_AUTOMATIC_DISCOVERY_RANGE={reach}")
        peers = []
    alone = reach in ("OFF", "LOCALHOST") and not peers
    sizes = f"<Internal><MaxSampleSize>{largest}B</MaxSampleSize></Internal>"
    ours = f'<CycloneDDS><Domain Id="any">{sizes}{_discovery(reach, peers)}</Domain></CycloneDDS>'
    if alone:
        notes.append(
            "only this machine is heard" if reach == "LOCALHOST" else "nobody is looked for, and nobody finds us"
        )
    return Network(
        ",".join(filter(None, (ours, environment.get("CYCLONEDDS_URI")))), alone, tuple(notes), reach, tuple(peers)
    )


def _discovery(reach: str, peers: list[str]) -> str:
    silent = "<General><AllowMulticast>false</AllowMulticast></General>"
    if reach == "OFF":  # nobody has the same tag
        tag = f"<Tag>ros_discovery_off_{os.getpid()}</Tag>"
        return f"{silent}<Discovery><ParticipantIndex>none</ParticipantIndex>{tag}</Discovery>"
    if reach in ("", "SYSTEM_DEFAULT"):
        return ""
    found = [*(["localhost"] if reach == "LOCALHOST" else []), *peers]
    named = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in found)
    most = f"<MaxAutoParticipantIndex>{_PROCESSES}</MaxAutoParticipantIndex>"
    index = f"<ParticipantIndex>auto</ParticipantIndex>{most}"
    discovery = f"<Discovery>{index}{f'<Peers>{named}</Peers>' if named else ''}</Discovery>"
    return (silent if reach == "LOCALHOST" else "") + discovery


def sockets() -> set[int]:
    """The descriptors of those that this process has open."""
    found = set()
    for name in os.listdir("/proc/self/fd"):
        with suppress(OSError):  # the list itself had one
            if stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                found.add(int(name))
    return found


def confine(before: set[int]) -> None:
    """Has the kernel drop what others send to the UDP sockets opened since, which Cyclone binds to all interfaces.

    The filter goes by the interface that a packet came by. What processes of one machine send each other comes by `lo`,
    whatever their addresses, so they find each other at any of them. Raises OSError where the kernel refuses it.
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
        with socket.socket(fileno=os.dup(descriptor)) as found:
            if found.type == socket.SOCK_DGRAM and found.family in (socket.AF_INET, socket.AF_INET6):
                found.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, program)


_SO_ATTACH_FILTER = 26
_LOAD, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x15, 0x06
_INTERFACE = 0xFFFFF008
"""SKF_AD_OFF + SKF_AD_IFINDEX (linux/filter.h): the number of the interface, as if it stood in the packet."""
