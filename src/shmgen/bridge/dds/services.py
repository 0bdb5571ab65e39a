"""Services of ROS 2 as two topics, request and reply, as rmw_cyclonedds and as rmw_fastrtps do.

Both must say whose call a request or a reply is. rmw_cyclonedds puts 16 bytes before it, and rmw_fastrtps says it
inline, which Cyclone neither shows nor lets us set, and Fast DDS does. Who has an identity in its user data is of the
first kind, as we are. An end of the other kind would take those 16 bytes for a message, and we its message for them: so
what goes to a server depends on the server, and where our ends are Cyclone's nothing passes between us and such a peer.
"""

from __future__ import annotations

import itertools
import queue
import struct
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from shmgen.bridge.backend import Answer, NoAnswer, Refuse, RosClient, ServiceWire, await_server
from shmgen.bridge.codec.cdr import codec
from shmgen.bridge.codec.type_identity import Identity, type_name
from shmgen.bridge.dds.entities import word_of
from shmgen.bridge.dds.service_pair import Came, Pair, ServiceTransport, Side
from shmgen.bridge.dds.types import reply_name, request_name, structure
from shmgen.core.model import Message

_CALL = struct.Struct("<Qq")
"""Whose call, and which: CALL as bytes. Its 16 keep the alignment of what follows."""
_ENCAPSULATION = 4
_READER = 0x04
"""The bit of a GUID's last byte that a reader has and a writer has not (DDSI-RTPS 2.5, 9.3.1.2)."""
_GUID = 16
_REPLY_READER = 2.0
"""Seconds a reply waits until its client's reader is known here, while its writer is; rmw_cyclonedds waits 0.1."""
_REPLY_READER_AT_ONCE = 20.0
"""The same where nobody else waits behind it: what would be lost is the end of a goal."""
_LOOK = 0.01
_PATIENCE = 0.1
"""Seconds that a call waits before it looks whether there still is a server."""

_STRANGER = "a peer is not on rmw_cyclonedds: nothing passes between us and it"
_HINT = "start it with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or the bridge with --backend ros2"
_BOTH = "there are servers on rmw_cyclonedds and on rmw_fastrtps, and each would take the other's request for its own"


def serve(
    transport: ServiceTransport, wire: ServiceWire, tell: Callable[[str], None], answer: Answer, refuse: Refuse
) -> Callable[[], None]:
    """Calls `answer` in the thread of the service, request after request. Gives what ends it. Raises ValueError for a
    `wstring`.
    """
    return _Served(transport, wire, tell, answer, refuse).close


def client(
    transport: ServiceTransport, wire: ServiceWire, tell: Callable[[str], None]
) -> tuple[RosClient, Callable[[], None]]:
    """And what ends it. Raises ValueError for a `wstring`."""
    asking = _Client(transport, wire, tell)
    return RosClient(asking.request.new, asking.call, asking.is_connected), asking.close


class _Half:
    """What the two ends of a service have in common."""

    pair: Pair

    def __init__(
        self,
        transport: ServiceTransport,
        wire: ServiceWire,
        tell: Callable[[str], None],
        ours: str,
        theirs: str,
        refuse: Refuse,
    ) -> None:
        self.request, self.response = codec(wire.request), codec(wire.response)
        self._transport = transport
        self._closed = False
        self._name = wire.service
        self._tell = tell
        self._theirs = theirs
        self._refuse = refuse
        self._told = False
        us = f"{ours}={'.'.join(f'{byte:x}' for byte in uuid.uuid4().bytes)};"
        self._asks = _side(request_name(wire.service), wire.request, f"{us}typehash={self.request.type_hash};")
        self._answers = _side(reply_name(wire.service), wire.response, f"{us}typehash={self.response.type_hash};")
        self._asked = Identity(wire.service, wire.request[-1].name, self.request.type_hash, tell)
        self._answered = Identity(wire.service, wire.response[-1].name, self.response.type_hash, tell)

    def close(self) -> None:
        """Nothing of what still comes is answered."""
        self._closed = True
        self.pair.close()

    def _id(self, words: list[str]) -> str:
        """Nothing of one that says inline whose call it is."""
        return word_of(words, self._theirs)

    def _strange(self) -> None:
        self._refuse(_STRANGER)
        if not self._told:
            self._told = True
            self._tell(f"{self._name}: {_STRANGER}; {self._transport.why}{_HINT}")


class _Served(_Half):
    def __init__(
        self,
        transport: ServiceTransport,
        wire: ServiceWire,
        tell: Callable[[str], None],
        answer: Answer,
        refuse: Refuse,
    ) -> None:
        super().__init__(transport, wire, tell, "serviceid", "clientid", refuse)
        self._answer = answer
        self._at_once = wire.at_once
        self.pair = transport.pair(self._asks, self._answers, self._met)
        self.pair.listen(self._came, self._name)

    def _met(self, words: list[str], heard: bool) -> None:
        if heard and (why := self._asked.refusal(_hash(words))):
            self._refuse(why)
        elif heard and not self._transport.inline and not self._id(words):
            self._strange()

    def _came(self, came: Came) -> None:
        if self._closed:
            return
        if why := self._asked.refusal(_hash(came.words)):
            self._refuse(why)
        elif not self._id(came.words) and not self._transport.inline:
            self._refuse(_STRANGER)
        else:
            try:
                before, asked = _split(came.cdr) if self._id(came.words) else (b"", came.cdr)
                request = self.request.decode(asked)
            except ValueError as error:
                self._refuse(str(error))
                raise  # who listens tells, not too often
            if self._at_once:
                threading.Thread(target=self._reply, args=(came, before, request), daemon=True).start()
            else:
                self._reply(came, before, request)

    def _reply(self, came: Came, before: bytes, request: Any) -> None:
        response = self.response.new()
        try:
            self._answer(request, response)
        except NoAnswer as error:  # ROS 2 has no word for it: the client waits in vain
            self._tell(f"{self._name}: no answer: {error}")
            return
        self._await_reader(came)
        reply = self.response.encode(response)
        self.pair.send(_joined(before, reply), came.call if not before else None)

    def _await_reader(self, came: Came) -> None:
        """A client whose writer we know may have a reader that we do not know yet, and that the reply would miss."""
        deadline = time.monotonic() + (_REPLY_READER_AT_ONCE if self._at_once else _REPLY_READER)
        while came.sender in self.pair.peers(heard=True) and not self._hears(came):
            if time.monotonic() >= deadline:
                return
            time.sleep(_LOOK)

    def _hears(self, came: Came) -> bool:
        hearing = self.pair.peers(heard=False)
        if theirs := self._id(came.words):
            return any(theirs == self._id(words) for words in hearing.values())
        return not came.call[_GUID - 1] & _READER or came.call[:_GUID] in hearing


class _Client(_Half):
    def __init__(self, transport: ServiceTransport, wire: ServiceWire, tell: Callable[[str], None]) -> None:
        super().__init__(transport, wire, tell, "clientid", "serviceid", lambda why: None)
        self._guid = uuid.uuid4().int & (2**64 - 1)
        self._numbers = itertools.count(1)
        self._waiting: dict[bytes, queue.SimpleQueue[bytes | NoAnswer]] = {}
        self._sending = threading.Lock()
        """Held until it is known by what the reply will be known."""
        self.pair = transport.pair(self._answers, self._asks, self._met)
        self.pair.listen(self._came, self._name)

    def _met(self, words: list[str], heard: bool) -> None:
        if not heard and not self._transport.inline and not self._id(words):
            self._strange()

    def is_connected(self) -> bool:
        return bool(self.pair.peers(heard=True) and self.pair.peers(heard=False))

    def call(self, message: Any, timeout: float) -> Any:
        deadline = await_server(self.is_connected, timeout)
        servers = self.pair.peers(heard=False)
        inline = self._inline(list(servers.values()))
        answer: queue.SimpleQueue[bytes | NoAnswer] = queue.SimpleQueue()
        with self._sending:
            call = self._send(self.request.encode(message), inline)
            self._waiting[call] = answer
        try:
            while True:
                with suppress(queue.Empty):
                    came = answer.get(timeout=max(0.0, min(_PATIENCE, deadline - time.monotonic())))
                    break
                if not servers.keys() & self.pair.peers(heard=False).keys():
                    raise NoAnswer("the server has gone")
                if time.monotonic() >= deadline:
                    raise NoAnswer(f"no answer within {timeout:g} s")
        finally:
            del self._waiting[call]
        if isinstance(came, NoAnswer):
            raise came
        return self.response.decode(came)

    def _inline(self, servers: list[list[str]]) -> bool:
        """Whether these want to be asked so. Raises NoAnswer if they may not be asked at all."""
        strangers = [words for words in servers if not self._id(words)]
        if strangers and not self._transport.inline:
            raise NoAnswer(_STRANGER)
        for words in servers:
            if why := self._asked.refusal(_hash(words)):
                raise NoAnswer(why)
        if strangers and len(strangers) < len(servers):
            raise NoAnswer(_BOTH)
        return bool(strangers)

    def _send(self, request: bytes, inline: bool) -> bytes:
        """Gives what its reply is known by."""
        if inline:
            return self.pair.send(request)
        call = _CALL.pack(self._guid, next(self._numbers))
        self.pair.send(_joined(call, request))
        return call

    def _came(self, came: Came) -> None:
        call, answer = _split(came.cdr) if self._id(came.words) else (came.call, came.cdr)
        with self._sending:
            caller = self._waiting.get(call)
        if caller:
            caller.put(NoAnswer(why) if (why := self._answered.refusal(_hash(came.words))) else answer)


def _side(topic: str, messages: tuple[Message, ...], words: str) -> Side:
    return Side(topic, type_name(messages[-1].name), structure(messages, of_call=True), words)


def _hash(words: list[str]) -> str:
    return word_of(words, "typehash").partition("=")[2]


def _split(cdr: bytes) -> tuple[bytes, bytes]:
    """The call, and the message without it. Raises ValueError for another byte order than ours."""
    if cdr[1] != 1:
        raise ValueError("a call from a big-endian machine")
    start = _ENCAPSULATION + _CALL.size
    return cdr[_ENCAPSULATION:start], cdr[:_ENCAPSULATION] + cdr[start:]


def _joined(call: bytes, cdr: bytes) -> bytes:
    return cdr[:_ENCAPSULATION] + call + cdr[_ENCAPSULATION:]
