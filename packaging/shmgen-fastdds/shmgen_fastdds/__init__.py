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
_WORDS = 4096
"""Maximum bytes of a peer's user data."""
_PEERS = 1024
"""Maximum number of peer readers, and of peer writers, of one service."""
_GET_ADDRESS = 0x8915
"""SIOCGIFADDR (linux/sockios.h)."""
_EVERYBODY = "239.255.0.1"
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
        ours = addresses() or ["127.0.0.1"] if network.reach == "LOCALHOST" else []
        peers = [*ours, *_resolved(network.peers, node.log)]
        if peers and not ours:
            peers.append(_EVERYBODY)
        before = sockets()
        handle = library.fast_join(
            domain,
            f"{node.name}_services".encode(),
            " ".join(peers).encode(),
            " ".join(ours).encode(),
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
        words = ctypes.create_string_buffer(_WORDS)
        length = self._library.fast_said(self._handle, peer, words, _WORDS)
        if length < 0:
            raise LookupError(peer)
        return words.raw[: min(length, _WORDS)].decode(errors="replace").split(";")

    def send(self, cdr: bytes, call: bytes | None = None) -> bytes:
        sent = ctypes.create_string_buffer(_CALL)
        if not self._library.fast_send(self._handle, cdr, ctypes.c_uint32(len(cdr)), call, sent):
            self._log("Fast DDS has not sent a request or a reply")
        return sent.raw

    def close(self) -> None:
        self._library.fast_close(self._handle)

    def listen(self, callback: Callable[[ReceivedCall], None], name: str) -> None:
        threading.Thread(target=self._run, args=(callback, name), name=name, daemon=True).start()

    def _run(self, callback: Callable[[ReceivedCall], None], name: str) -> None:
        buffer = ctypes.create_string_buffer(self._largest)
        sender, call = ctypes.create_string_buffer(_GUID), ctypes.create_string_buffer(_CALL)
        room, callback = ctypes.c_uint32(self._largest), guarded(callback, name, self._log)
        while (size := self._library.fast_take(self._handle, buffer, room, sender, call)) >= 0:
            if not size:
                self.peers(True)
                self.peers(False)
                continue
            try:
                words = self._user_data_of(sender.raw, True)
            except LookupError:  # the client has left already and awaits no answer
                continue
            callback(ReceivedCall(ctypes.string_at(buffer, size), words, sender.raw, call.raw))


def _resolved(names: Iterable[str], log: Callable[[str], None]) -> list[str]:
    resolved = []
    for name in names:
        try:
            resolved.append(socket.getaddrinfo(name, None, socket.AF_INET)[0][4][0])
        except OSError as error:
            log(f"dds: services do not find {name}: {error}")
    return [str(address) for address in resolved]


def addresses() -> list[str]:
    """Return the IPv4 address of each network interface of this machine, except loopback addresses.

    If each address is listed in the configuration, Fast DDS does not announce itself as 127.0.0.1. Cyclone ignores
    announcements from there.
    """
    interface_addresses = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with suppress(OSError):  # the interface has no IPv4 address
                answer = fcntl.ioctl(probe, _GET_ADDRESS, struct.pack("256s", name.encode()))
                interface_addresses.append(socket.inet_ntoa(answer[20:24]))
    return [address for address in interface_addresses if not address.startswith("127.")]
