"""Services of ROS 2 as two topics, request and reply, compatible with rmw_cyclonedds and rmw_fastrtps.

Each request and reply must identify its call. rmw_cyclonedds puts 16 bytes before the message. rmw_fastrtps sends the
identity inline, as metadata of the sample. Fast DDS gives access to inline identities, and Cyclone does not.

A peer with an identity in its user data uses the 16 bytes, and so does the bridge. A peer without an identity uses the
inline form. An inline peer would read the 16 bytes as the start of a message, so the form of a request depends on the
server. If the bridge uses Cyclone for services, nothing passes between the bridge and an inline peer.
"""

from __future__ import annotations

import itertools
import struct
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from shmgen.bridge.backend import Answer, ErrorSink, NoAnswer, ServiceWire
from shmgen.bridge.codec.cdr import codec
from shmgen.bridge.codec.type_identity import Identity, type_name
from shmgen.bridge.common.support import await_answer, await_server, guarded
from shmgen.bridge.dds.service_pair import Direction, Pair, ReceivedCall, ServiceTransport
from shmgen.bridge.dds.types import reply_name, request_name, structure
from shmgen.core.model import Message

_CALL = struct.Struct("<Qq")
"""The identity of a call as bytes: the client's GUID and a number. 16 bytes keep the message aligned."""
_ENCAPSULATION = 4
"""Bytes of the CDR encapsulation header."""
_READER = 0x04
"""The bit of a GUID's last byte that is set for a reader and clear for a writer (DDSI-RTPS 2.5, 9.3.1.2)."""
_GUID = 16
"""Bytes of a GUID."""
_REPLY_READER = 2.0
"""Maximum seconds that a reply waits for the discovery of its client's reader. rmw_cyclonedds waits 0.1 s."""
_REPLY_READER_AT_ONCE = 20.0
"""Maximum seconds that a reply waits in its own thread, for example the result of a goal, which must not be lost."""
_READER_POLL_INTERVAL = 0.01
"""Seconds between two checks for the client's reader."""

_INCOMPATIBLE = "a peer does not use rmw_cyclonedds: no messages pass between it and the bridge"
_HINT = "start the peer with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or the bridge with --backend ros2"
_BOTH = "two servers use rmw_cyclonedds and rmw_fastrtps, and one would misread the request: stop one of the servers"


class _Half:
    """The common part of the server and the client of a service."""

    pair: Pair
    own_identity_key: str
    """The key of the identity in the bridge's user data."""
    peer_identity_key: str
    """The key of the identity in the user data of a peer."""

    def __init__(self, transport: ServiceTransport, wire: ServiceWire, log: Callable[[str], None]) -> None:
        self.request, self.response = codec(wire.request), codec(wire.response)
        self._transport = transport
        self._closed = False
        self._name = wire.name
        self._log = log
        self._at_once = wire.at_once
        self._is_logged = False
        us = f"{self.own_identity_key}={'.'.join(f'{byte:x}' for byte in uuid.uuid4().bytes)};"
        self._requests = _direction(request_name(wire.name), wire.request, f"{us}typehash={self.request.type_hash};")
        self._responses = _direction(reply_name(wire.name), wire.response, f"{us}typehash={self.response.type_hash};")
        self._request_identity = Identity(wire.name, wire.request[-1].name, self.request.type_hash, log)
        self._response_identity = Identity(wire.name, wire.response[-1].name, self.response.type_hash, log)

    def close(self) -> None:
        """Remove this server or client. Requests that still arrive get no answer."""
        self._closed = True
        self.pair.close()

    def _id(self, words: dict[str, str]) -> str:
        """Return the identity in a peer's user data, or `""` if the peer sends an identity inline with each call."""
        return words.get(self.peer_identity_key, "")

    def _report_incompatible(self) -> None:
        if not self._is_logged:
            self._is_logged = True
            self._log(f"{self._name}: {_INCOMPATIBLE}; {self._transport.why}{_HINT}")


class Server(_Half):
    """A service that the bridge offers. `answer` handles the requests one by one, or in parallel with `at_once`."""

    own_identity_key, peer_identity_key = "serviceid", "clientid"

    def __init__(
        self,
        transport: ServiceTransport,
        wire: ServiceWire,
        log: Callable[[str], None],
        errors: ErrorSink,
        answer: Answer,
    ) -> None:
        super().__init__(transport, wire, log)
        self._errors, self._answer = errors, answer
        self.pair = transport.pair(self._requests, self._responses, self._on_peer)
        self.pair.listen(self._on_received, self._name)

    def _on_peer(self, words: dict[str, str], is_writer: bool) -> None:
        if is_writer and (why := self._request_identity.refusal(words.get("typehash", ""))):
            self._errors.refuse(why)
        elif is_writer and not self._transport.inline and not self._id(words):
            self._errors.refuse(_INCOMPATIBLE)
            self._report_incompatible()

    def _on_received(self, received: ReceivedCall) -> None:
        if self._closed:
            return
        if why := self._request_identity.refusal(received.words.get("typehash", "")):
            self._errors.refuse(why)
        elif not self._id(received.words) and not self._transport.inline:
            self._errors.refuse(_INCOMPATIBLE)
        else:
            try:
                before, body = _split(received.cdr) if self._id(received.words) else (b"", received.cdr)
                request = self.request.decode(body)
            except ValueError as error:
                self._errors.refuse(str(error))
                raise  # the reading thread logs it at a limited rate
            if self._at_once:
                reply = guarded(self._reply, self._name, self._log)
                threading.Thread(target=reply, args=(received, before, request), daemon=True).start()
            else:
                self._reply(received, before, request)

    def _reply(self, received: ReceivedCall, before: bytes, request: Any) -> None:
        response = self.response.new()
        try:
            self._answer(request, response)
        except NoAnswer as error:  # ROS 2 has no error reply: the client waits until its timeout
            self._log(f"{self._name}: no answer: {error}")
            return
        self._await_reader(received)
        reply = self.response.encode(response)
        self.pair.send(_insert_call(before, reply), received.call if not before else None)

    def _await_reader(self, received: ReceivedCall) -> None:
        """Wait until the client's reader is discovered. Before that, the client would miss the reply."""
        deadline = time.monotonic() + (_REPLY_READER_AT_ONCE if self._at_once else _REPLY_READER)
        while received.sender in self.pair.peers(is_writer=True) and not self._is_reader_known(received):
            if time.monotonic() >= deadline:
                return
            time.sleep(_READER_POLL_INTERVAL)

    def _is_reader_known(self, received: ReceivedCall) -> bool:
        hearing = self.pair.peers(is_writer=False)
        if peer_identity_key := self._id(received.words):
            return any(peer_identity_key == self._id(words) for words in hearing.values())
        return not received.call[_GUID - 1] & _READER or received.call[:_GUID] in hearing


class Client(_Half):
    """A client of a service, with the functions of a RosClient."""

    own_identity_key, peer_identity_key = "clientid", "serviceid"

    def __init__(self, transport: ServiceTransport, wire: ServiceWire, log: Callable[[str], None]) -> None:
        super().__init__(transport, wire, log)
        self._guid = uuid.uuid4().int & (2**64 - 1)
        self._numbers = itertools.count(1)
        self._waiting: dict[bytes, Future[bytes]] = {}
        self._sending = threading.Lock()
        """Held until the identity of the sent call is registered."""
        self.pair = transport.pair(self._responses, self._requests, self._on_peer)
        self.pair.listen(self._on_received, self._name)

    def _on_peer(self, words: dict[str, str], is_writer: bool) -> None:
        if not is_writer and not self._transport.inline and not self._id(words):
            self._report_incompatible()

    def is_connected(self) -> bool:
        return bool(self.pair.peers(is_writer=True) and self.pair.peers(is_writer=False))

    def call(self, message: Any, timeout: float) -> Any:
        deadline = await_server(self.is_connected, timeout)
        servers = self.pair.peers(is_writer=False)
        inline = self._inline(list(servers.values()))
        answer: Future[bytes] = Future()
        with self._sending:
            call = self._send(self.request.encode(message), inline)
            self._waiting[call] = answer

        def end_reason() -> str:
            return "" if servers.keys() & self.pair.peers(is_writer=False).keys() else "the server has left"

        try:
            return self.response.decode(await_answer(answer, timeout, deadline, end_reason))
        finally:
            self._waiting.pop(call, None)

    def _inline(self, servers: list[dict[str, str]]) -> bool:
        """Return True if the servers require inline identities. `servers` has the user data of each server.

        Raises NoAnswer if a server is incompatible, or if only some of the servers require inline identities.
        """
        incompatible = [words for words in servers if not self._id(words)]
        if incompatible and not self._transport.inline:
            raise NoAnswer(_INCOMPATIBLE)
        for words in servers:
            if why := self._request_identity.refusal(words.get("typehash", "")):
                raise NoAnswer(why)
        if incompatible and len(incompatible) < len(servers):
            raise NoAnswer(_BOTH)
        return bool(incompatible)

    def _send(self, request: bytes, inline: bool) -> bytes:
        """Send a request and return the identity of the call, by which the reply is recognized."""
        if inline:
            return self.pair.send(request)
        call = _CALL.pack(self._guid, next(self._numbers))
        self.pair.send(_insert_call(call, request))
        return call

    def _on_received(self, received: ReceivedCall) -> None:
        call, answer = _split(received.cdr) if self._id(received.words) else (received.call, received.cdr)
        with self._sending:
            caller = self._waiting.pop(call, None)
        if caller and (why := self._response_identity.refusal(received.words.get("typehash", ""))):
            caller.set_exception(NoAnswer(why))
        elif caller:
            caller.set_result(answer)


def _direction(topic: str, messages: tuple[Message, ...], words: str) -> Direction:
    return Direction(topic, type_name(messages[-1].name), structure(messages, of_call=True), words)


def _split(cdr: bytes) -> tuple[bytes, bytes]:
    """Split `cdr`, a request or reply, into the call's identity and the message. Raises ValueError if big-endian."""
    if cdr[1] != 1:
        raise ValueError("the call is from a big-endian machine, which the bridge cannot read")
    start = _ENCAPSULATION + _CALL.size
    return cdr[_ENCAPSULATION:start], cdr[:_ENCAPSULATION] + cdr[start:]


def _insert_call(call: bytes, cdr: bytes) -> bytes:
    return cdr[:_ENCAPSULATION] + call + cdr[_ENCAPSULATION:]
