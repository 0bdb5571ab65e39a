"""Turns services of ROS 2 into two topics, request and reply, as rmw_cyclonedds does.

Before each request and its reply go 16 bytes that say whose they are. rmw_fastrtps says it in the inline QoS
instead, which Cyclone neither shows nor lets us set: its clients and servers are not reached. They would take those 16
bytes for a message, and we theirs for the 16; so nothing passes between us and an end that has no identity in its user
data, and that is said as soon as the two meet: Cyclone drops what such an end sends before we see it.
"""

from __future__ import annotations

import itertools
import queue
import struct
import threading
import time
import uuid
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Qos
from cyclonedds.sub import DataReader

from shmgen.bridge.backend import QUEUE, Answer, Caller, NoAnswer, Refuse, ServiceWire
from shmgen.bridge.cdr import Codec, codec
from shmgen.bridge.dds_ends import Ends, Peers, matches, quality, said_by, send, word_of
from shmgen.bridge.dds_types import CALL, reply_name, request_name, structure
from shmgen.bridge.identity import Identity
from shmgen.model import Message

_CALL = struct.Struct("<Qq")
"""Whose call, and which: CALL as bytes. Its 16 keep the alignment of what follows."""
_ENCAPSULATION = 4
_REPLY_READER = 2.0
"""Seconds a reply waits until its client's reader is known here, while its writer is; rmw_cyclonedds waits 0.1."""
_REPLY_READER_AT_ONCE = 20.0
"""The same where nobody else waits behind it: what would be lost is the end of a goal."""
_LOOK = 0.01
_PATIENCE = 0.1
"""Seconds that a call waits before it looks whether there still is a server."""


_STRANGER = "a peer is not on rmw_cyclonedds: nothing passes between us and it"
_HINT = "start it with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or the bridge with --backend ros2"


def serve(ends: Ends, wire: ServiceWire, answer: Answer, refuse: Refuse) -> None:
    """Calls `answer` in the thread of the service, request after request. Raises ValueError for a `wstring`."""
    request, response = codec(wire.request), codec(wire.response)
    us = _identity("serviceid")
    peers = Peers(_meant(ends, wire.service, wire.request, request), refuse)
    strangers = _Strangers(ends, wire.service, "clientid", refuse)

    def met(entity: Any, handle: int) -> None:
        peers.matched(entity, handle)
        strangers.matched(entity, handle)

    requests = ends.reader(request_name(wire.service), structure(wire.request, before=CALL), _quality(us, request), met)
    strangers.look(requests, matches(requests))
    replies = ends.writer(reply_name(wire.service), structure(wire.response, before=CALL), _quality(us, response))

    def answered(sample: Any) -> None:
        theirs = _identity_of(requests, sample.sample_info.publication_handle, "clientid")
        if why := peers.refusal(requests, sample):
            refuse(why)
            return
        if not theirs:
            refuse(_STRANGER)
            return
        if wire.at_once:
            threading.Thread(target=reply, args=(sample, theirs), daemon=True).start()
        else:
            reply(sample, theirs)

    def reply(sample: Any, theirs: str) -> None:
        call, asked = _split(sample.cdr)
        message = response.new()
        try:
            answer(request.decode(asked), message)
        except NoAnswer as error:  # ROS 2 has no word for it: the client waits in vain
            ends.tell(f"{wire.service}: no answer: {error}")
            return
        patience = _REPLY_READER_AT_ONCE if wire.at_once else _REPLY_READER
        _await_reader(replies, requests, theirs, patience)
        with suppress(DDSException):  # the bridge has ended meanwhile
            send(replies, _joined(call, response.encode(message)))

    ends.listen(requests, answered, wire.service)


def client(ends: Ends, wire: ServiceWire) -> Caller:
    """Raises ValueError for a `wstring`."""
    request, response = codec(wire.request), codec(wire.response)
    us = _identity("clientid")
    strangers = _Strangers(ends, wire.service, "serviceid", lambda why: None)
    requests = ends.writer(
        request_name(wire.service), structure(wire.request, before=CALL), _quality(us, request), strangers.matched
    )
    strangers.look(requests, matches(requests))
    peers = Peers(_meant(ends, wire.service, wire.response, response), lambda why: None)
    replies = ends.reader(
        reply_name(wire.service), structure(wire.response, before=CALL), _quality(us, response), peers.matched
    )
    asked = _meant(ends, wire.service, wire.request, request)
    guid = requests.get_instance_handle() & (2**64 - 1)
    numbers = itertools.count(1)
    waiting: dict[int, queue.SimpleQueue[bytes | NoAnswer]] = {}

    def replied(sample: Any) -> None:
        (whose, number), answer = _split(sample.cdr)
        if whose == guid and (caller := waiting.get(number)):
            caller.put(NoAnswer(why) if (why := peers.refusal(replies, sample)) else answer)

    def is_connected() -> bool:
        return bool(matches(requests) and matches(replies))

    def call(message: Any, timeout: float) -> Any:
        deadline = time.monotonic() + timeout
        while not is_connected():
            if time.monotonic() >= deadline:
                raise NoAnswer(f"no server within {timeout:g} s")
            time.sleep(_LOOK)
        if not all(_identities(requests, "serviceid")):
            raise NoAnswer(_STRANGER)
        for handle in matches(requests):
            if why := asked.refusal(_identity_of(requests, handle, "typehash").partition("=")[2]):
                raise NoAnswer(why)
        number, known = next(numbers), set(matches(requests))
        waiting[number] = queue.SimpleQueue()
        try:
            send(requests, _joined((guid, number), request.encode(message)))
            while True:
                with suppress(queue.Empty):
                    answer = waiting[number].get(timeout=max(0.0, min(_PATIENCE, deadline - time.monotonic())))
                    break
                if not known & set(matches(requests)):
                    raise NoAnswer("the server has gone")
                if time.monotonic() >= deadline:
                    raise NoAnswer(f"no answer within {timeout:g} s")
        finally:
            del waiting[number]
        if isinstance(answer, NoAnswer):
            raise answer
        return response.decode(answer)

    ends.listen(replies, replied, wire.service)
    return Caller(request.new, call, is_connected)


class _Strangers:
    """Those who keep to another middleware's services; told of once a service."""

    def __init__(self, ends: Ends, service: str, role: str, refuse: Refuse) -> None:
        self._ends, self._service, self._role, self._refuse = ends, service, role, refuse
        self._known: set[int] = set()

    def matched(self, entity: Any, handle: int) -> None:
        """A Matched."""
        self.look(entity, [handle])

    def look(self, entity: Any, handles: Iterable[int]) -> None:
        """At peers that came before we could be told."""
        for handle in handles:
            with suppress(LookupError):  # gone meanwhile
                if handle not in self._known and not word_of(said_by(entity, handle), self._role):
                    if not self._known:
                        self._ends.tell(f"{self._service}: {_STRANGER}; {_HINT}")
                    self._known.add(handle)
                    self._refuse(_STRANGER)


def _identity(role: str) -> str:
    """By which rmw_cyclonedds tells which reader and which writer belong together."""
    return f"{role}={'.'.join(f'{byte:x}' for byte in uuid.uuid4().bytes)};"


def _quality(identity: str, made: Codec) -> Qos:
    return quality("reliable", False, QUEUE, f"{identity}typehash={made.type_hash};")


def _split(cdr: bytes) -> tuple[tuple[int, int], bytes]:
    """The call, and the message without it. Raises ValueError for another byte order than ours."""
    if cdr[1] != 1:
        raise ValueError("a call from a big-endian machine")
    start = _ENCAPSULATION + _CALL.size
    return _CALL.unpack_from(cdr, _ENCAPSULATION), cdr[:_ENCAPSULATION] + cdr[start:]


def _joined(call: tuple[int, int], cdr: bytes) -> bytes:
    return cdr[:_ENCAPSULATION] + _CALL.pack(*call) + cdr[_ENCAPSULATION:]


def _await_reader(replies: DataWriter, requests: DataReader, client: str, patience: float) -> None:
    """A client whose writer we know may have a reader that we do not know yet, and that the reply would miss."""
    deadline = time.monotonic() + patience
    with suppress(DDSException):  # the bridge has ended meanwhile
        while client not in _identities(replies, "clientid") and client in _identities(requests, "clientid"):
            if time.monotonic() >= deadline:
                return
            time.sleep(_LOOK)


def _identities(end: DataReader | DataWriter, role: str) -> list[str]:
    """Of those whom we read, or who read what we write; empty where one has none."""
    return [_identity_of(end, handle, role) for handle in matches(end)]


def _identity_of(end: DataReader | DataWriter, handle: int, role: str) -> str:
    try:
        return word_of(said_by(end, handle), role)
    except LookupError:  # gone meanwhile
        return ""


def _meant(ends: Ends, service: str, messages: tuple[Message, ...], made: Codec) -> Identity:
    return Identity(service, messages[-1].name, made.type_hash, ends.tell)
