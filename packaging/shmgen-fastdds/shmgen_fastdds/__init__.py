"""Turns a service into a reader and a writer of Fast DDS, which can say inline whose call a sample is."""

from __future__ import annotations

import ctypes
import fcntl
import socket
import struct
import threading
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from pathlib import Path

from shmgen.bridge.backend import Node, RateLimitedLog, queue_of
from shmgen.bridge.dds.network import Network, confine, sockets
from shmgen.bridge.dds.service_pair import Came, Met, Pair, Side

_LIBRARY = Path(__file__).with_name("services.so")
_GUID = 16
_CALL = 24
"""Bytes of what says whose call it is: the GUID of who asks, and a number."""
_HEADER = 20
"""Bytes that may come before a message: encapsulation, and whose call it is as rmw_cyclonedds has it."""
_WORDS = 4096
_PEERS = 1024
"""Ends of others that one service may have."""
_GET_ADDRESS = 0x8915
"""SIOCGIFADDR (linux/sockios.h)."""
_EVERYBODY = "239.255.0.1"
"""To whom multicast goes, which must be said where anybody else is named (DDSI-RTPS 2.5, 9.6.2.4)."""


class Fast:
    """A ServiceTransport: one more participant of this process, for services alone. `leave()` ends its threads."""

    inline = True
    why = ""

    def __init__(self, node: Node, domain: int, network: Network) -> None:
        """As the participant `<node>_services`. Raises OSError where it cannot join, or is of another Fast DDS."""
        self._library = library = ctypes.CDLL(str(_LIBRARY))
        for function in (library.fast_join, library.fast_open):
            function.restype = ctypes.c_void_p
        self._tell = node.tell
        self._largest = node.largest + _HEADER
        ours = addresses() or ["127.0.0.1"] if network.reach == "LOCALHOST" else []
        peers = [*ours, *_resolved(network.peers, node.tell)]
        if peers and not ours:
            peers.append(_EVERYBODY)
        before = sockets()
        found = library.fast_join(
            domain,
            f"{node.name}_services".encode(),
            " ".join(peers).encode(),
            " ".join(ours).encode(),
            ctypes.c_uint32(self._largest),
        )
        if not found:
            raise OSError(f"Fast DDS cannot join domain {domain}")
        self._handle = ctypes.c_void_p(found)
        if network.alone:
            try:
                confine(before)
            except OSError:
                self.leave()
                raise

    def pair(self, hears: Side, says: Side, met: Met) -> Pair:
        """Raises ValueError where it cannot be had."""
        sides = [
            (ctypes.c_char_p * 3)(side.topic.encode(), side.type_name.encode(), side.words.encode())
            for side in (hears, says)
        ]
        found = self._library.fast_open(self._handle, *sides, queue_of(self._largest))
        if not found:
            raise ValueError(f"Fast DDS cannot open {hears.topic} and {says.topic}")
        return FastPair(self._library, ctypes.c_void_p(found), self._largest, met, self._tell)

    def leave(self) -> None:
        """Waits for nobody but a sample that is being sent."""
        self._library.fast_leave(self._handle)


class FastPair(Pair):
    """Peers go by their GUIDs."""

    def __init__(
        self, library: ctypes.CDLL, handle: ctypes.c_void_p, largest: int, met: Met, tell: Callable[[str], None]
    ) -> None:
        super().__init__(met)
        self._library, self._handle, self._largest, self._tell = library, handle, largest, tell

    def _matched(self, heard: bool) -> list[Hashable]:
        found = ctypes.create_string_buffer(_GUID * _PEERS)
        count = min(_PEERS, self._library.fast_peers(self._handle, not heard, found, _PEERS))
        guids = ctypes.string_at(found, count * _GUID)
        return [guids[start : start + _GUID] for start in range(0, len(guids), _GUID)]

    def _said(self, peer: Hashable, heard: bool) -> list[str]:
        words = ctypes.create_string_buffer(_WORDS)
        length = self._library.fast_said(self._handle, peer, words, _WORDS)
        if length < 0:
            raise LookupError(peer)
        return words.raw[: min(length, _WORDS)].decode(errors="replace").split(";")

    def send(self, cdr: bytes, call: bytes | None = None) -> bytes:
        sent = ctypes.create_string_buffer(_CALL)
        if not self._library.fast_send(self._handle, cdr, ctypes.c_uint32(len(cdr)), call, sent):
            self._tell("Fast DDS has not sent a request or a reply")
        return sent.raw

    def close(self) -> None:
        self._library.fast_close(self._handle)

    def listen(self, callback: Callable[[Came], None], name: str) -> None:
        threading.Thread(target=self._run, args=(callback, name), name=name, daemon=True).start()

    def _run(self, callback: Callable[[Came], None], name: str) -> None:
        taken = ctypes.create_string_buffer(self._largest)
        sender, call = ctypes.create_string_buffer(_GUID), ctypes.create_string_buffer(_CALL)
        room, grumble = ctypes.c_uint32(self._largest), RateLimitedLog(name, self._tell)
        while (size := self._library.fast_take(self._handle, taken, room, sender, call)) >= 0:
            if not size:
                self.peers(True)
                self.peers(False)
                continue
            try:
                words = self._words_of(sender.raw, True)
            except LookupError:  # it came and went while we looked away: nobody waits for an answer
                continue
            try:
                callback(Came(ctypes.string_at(taken, size), words, sender.raw, call.raw))
            except Exception as error:  # one message is not worth the service
                grumble(error)


def _resolved(names: Iterable[str], tell: Callable[[str], None]) -> list[str]:
    found = []
    for name in names:
        try:
            found.append(socket.getaddrinfo(name, None, socket.AF_INET)[0][4][0])
        except OSError as error:
            tell(f"dds: services do not find {name}: {error}")
    return [str(address) for address in found]


def addresses() -> list[str]:
    """Of this machine, one for each interface that has one, but for the loopback's.

    Named one by one, Fast DDS does not turn them into 127.0.0.1, from where Cyclone takes no announcement.
    """
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            with suppress(OSError):  # it has none
                answer = fcntl.ioctl(asked, _GET_ADDRESS, struct.pack("256s", name.encode()))
                found.append(socket.inet_ntoa(answer[20:24]))
    return [address for address in found if not address.startswith("127.")]
