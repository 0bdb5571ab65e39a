"""Services over Fast DDS, as rmw_fastrtps offers them: each service is a reader and a writer.

Each message carries the identity of its call inline, as metadata beside its bytes.
"""

from __future__ import annotations

import ctypes
import fcntl
import socket
import struct
import threading
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from pathlib import Path

from shmgen.bridge.backend import Node, queue_of
from shmgen.bridge.common.support import guarded
from shmgen.bridge.dds.network import Network, confine, sockets
from shmgen.bridge.dds.service_pair import Direction, OnPeerDiscovered, Pair, ReceivedCall

_LIBRARY = Path(__file__).with_name("services.so")
_GUID = 16
"""Bytes of a GUID."""
_CALL = 24
"""Bytes of the identity of a call: the client's GUID and a number."""
_HEADER = 20
"""Maximum bytes before a message: the encapsulation header, and the call identity of rmw_cyclonedds."""
_USER_DATA = 4096
"""Maximum bytes of a peer's user data."""
_PEERS = 1024
"""Maximum number of peer readers, and of peer writers, of one service."""
_GET_ADDRESS = 0x8915
"""SIOCGIFADDR (linux/sockios.h)."""
_DISCOVERY_ADDRESS = "239.255.0.1"
"""The multicast address of discovery. It must be listed if other peers are listed (DDSI-RTPS 2.5, 9.6.2.4)."""


class Fast:
    """Serves and calls ROS 2 services by Fast DDS, as a ServiceTransport.

    It is a second DDS participant of this process, used only for services.
    """

    inline = True
    why = ""

    def __init__(self, node: Node, domain: int, network: Network) -> None:
        """Join the domain as the participant `<node>_services`.

        Raises OSError if that fails, or if the library was compiled against another version of Fast DDS.
        """
        self._library = library = ctypes.CDLL(str(_LIBRARY))
        for function in (library.fast_join, library.fast_open):
            function.restype = ctypes.c_void_p
        self._log = node.log
        self._largest = node.largest + _HEADER
        own_addresses = addresses() or ["127.0.0.1"] if network.reach == "LOCALHOST" else []
        peers = [*own_addresses, *_resolved(network.peers, node.log)]
        if peers and not own_addresses:
            peers.append(_DISCOVERY_ADDRESS)
        before = sockets()
        handle = library.fast_join(
            domain,
            f"{node.name}_services".encode(),
            " ".join(peers).encode(),
            " ".join(own_addresses).encode(),
            ctypes.c_uint32(self._largest),
        )
        if not handle:
            raise OSError(f"Fast DDS cannot join domain {domain}")
        self._handle = ctypes.c_void_p(handle)
        if network.alone:
            try:
                confine(before)
            except OSError:
                self.leave()
                raise

    def pair(self, reads: Direction, writes: Direction, on_peer: OnPeerDiscovered) -> Pair:
        """Create a reader and a writer for one service that the bridge serves or calls. Raises ValueError on errors."""
        sides = [
            (ctypes.c_char_p * 3)(side.topic.encode(), side.type_name.encode(), side.words.encode())
            for side in (reads, writes)
        ]
        handle = self._library.fast_open(self._handle, *sides, queue_of(self._largest))
        if not handle:
            raise ValueError(f"Fast DDS cannot open {reads.topic} and {writes.topic}")
        return FastPair(self._library, ctypes.c_void_p(handle), self._largest, on_peer, self._log)

    def leave(self) -> None:
        """Leave the domain permanently and end all threads of Fast DDS. Wait only for sends in progress."""
        self._library.fast_leave(self._handle)


class FastPair(Pair):
    """The reader and the writer of one service in Fast DDS. A peer is identified by its GUID."""

    def __init__(
        self,
        library: ctypes.CDLL,
        handle: ctypes.c_void_p,
        largest: int,
        on_peer: OnPeerDiscovered,
        log: Callable[[str], None],
    ) -> None:
        super().__init__(on_peer)
        self._library, self._handle, self._largest, self._log = library, handle, largest, log

    def _matched(self, is_writer: bool) -> list[Hashable]:
        buffer = ctypes.create_string_buffer(_GUID * _PEERS)
        count = min(_PEERS, self._library.fast_peers(self._handle, not is_writer, buffer, _PEERS))
        guids = ctypes.string_at(buffer, count * _GUID)
        return [guids[start : start + _GUID] for start in range(0, len(guids), _GUID)]

    def _read_user_data(self, peer: Hashable, is_writer: bool) -> list[str]:
        user_data = ctypes.create_string_buffer(_USER_DATA)
        length = self._library.fast_user_data(self._handle, peer, user_data, _USER_DATA)
        if length < 0:
            raise LookupError(peer)
        return user_data.raw[: min(length, _USER_DATA)].decode(errors="replace").split(";")

    def send(self, cdr: bytes, call: bytes | None = None) -> bytes:
        sent_call = ctypes.create_string_buffer(_CALL)
        if not self._library.fast_send(self._handle, cdr, ctypes.c_uint32(len(cdr)), call, sent_call):
            self._log("Fast DDS could not send a request or a reply")
        return sent_call.raw

    def close(self) -> None:
        self._library.fast_close(self._handle)

    def listen(self, callback: Callable[[ReceivedCall], None], name: str) -> None:
        threading.Thread(target=self._run, args=(callback, name), name=name, daemon=True).start()

    def _run(self, callback: Callable[[ReceivedCall], None], name: str) -> None:
        buffer = ctypes.create_string_buffer(self._largest)
        sender, call = ctypes.create_string_buffer(_GUID), ctypes.create_string_buffer(_CALL)
        capacity, callback = ctypes.c_uint32(self._largest), guarded(callback, name, self._log)
        while (size := self._library.fast_take(self._handle, buffer, capacity, sender, call)) >= 0:
            if not size:
                self.peers(True)
                self.peers(False)
                continue
            try:
                user_data = self._user_data_of(sender.raw, True)
            except LookupError:  # the client has left and waits for no reply
                continue
            callback(ReceivedCall(ctypes.string_at(buffer, size), user_data, sender.raw, call.raw))


def _resolved(names: Iterable[str], log: Callable[[str], None]) -> list[str]:
    """Return the IPv4 address of each host name. Log the names without one."""
    ipv4_addresses = []
    for name in names:
        try:
            ipv4_addresses.append(socket.getaddrinfo(name, None, socket.AF_INET)[0][4][0])
        except OSError as error:
            log(f"dds: no IPv4 address for the peer {name}, so its services are not discovered: {error}")
    return [str(address) for address in ipv4_addresses]


def addresses() -> list[str]:
    """Return the IPv4 address of each network interface of this machine, except loopback addresses.

    If Fast DDS is configured with these addresses, it does not announce itself as 127.0.0.1. Cyclone DDS ignores
    announcements from that address.
    """
    interface_addresses = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with suppress(OSError):  # the interface has no IPv4 address
                request = fcntl.ioctl(probe, _GET_ADDRESS, struct.pack("256s", name.encode()))
                interface_addresses.append(socket.inet_ntoa(request[20:24]))
    return [address for address in interface_addresses if not address.startswith("127.")]
