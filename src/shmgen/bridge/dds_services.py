"""Turns services of ROS 2 into two topics, request and reply, as rmw_cyclonedds does.

Before each request and its reply go 16 bytes that say whose they are. rmw_fastrtps says it in the inline QoS
instead, which Cyclone does not let us set: its clients and servers are not reached. They would take those 16 bytes
for a message, and we theirs for the 16; so nothing passes between us and an end that has no identity in its user data.
"""

from __future__ import annotations

import itertools
import queue
import struct
import time
import uuid
from typing import Any

from cyclonedds.pub import DataWriter
from cyclonedds.qos import Qos
from cyclonedds.sub import DataReader

from shmgen.bridge.backend import QUEUE, Answer, Caller, NoAnswer, Refuse, ServiceWire
from shmgen.bridge.cdr import Codec, codec
from shmgen.bridge.dds_ends import Ends, Peers, quality, said_by, send, word_of
from shmgen.bridge.dds_types import CALL, reply_name, request_name, structure
from shmgen.bridge.identity import Identity
from shmgen.model import Message

_CALL = struct.Struct("<Qq")
"""Whose call, and which: CALL as bytes. Its 16 keep the alignment of what follows."""
_ENCAPSULATION = 4
_REPLY_READER = 0.1
"""Seconds a reply waits until its client's reader is known here; rmw_cyclonedds waits as long."""
_LOOK = 0.01


def serve(ends: Ends, wire: ServiceWire, answer: Answer, refuse: Refuse) -> None:
    """Calls `answer` in the thread of the service, request after request. Raises ValueError for a `wstring`."""
    request, response = codec(wire.request), codec(wire.response)
    us = _identity("serviceid")
    peers = Peers(_meant(ends, wire.service, wire.request, request), refuse)
    requests = ends.reader(
        request_name(wire.service), structure(wire.request, before=CALL), _quality(us, request), peers.matched
    )
    replies = ends.writer(reply_name(wire.service), structure(wire.response, before=CALL), _quality(us, response))

    def answered(sample: Any) -> None:
        theirs = _identity_of(requests, sample.sample_info.publication_handle, "clientid")
        if why := peers.refusal(requests, sample):
            refuse(why)
            return
        if not theirs:
            ends.tell(f"{wire.service}: a client that is not on rmw_cyclonedds; not answered")
            return
        call, asked = _split(sample.cdr)
        message = response.new()
        try:
            answer(request.decode(asked), message)
        except NoAnswer as error:  # ROS 2 has no word for it: the client waits in vain
            ends.tell(f"{wire.service}: no answer: {error}")
            return
        _await_reader(replies, theirs)
        send(replies, _joined(call, response.encode(message)))

    ends.listen(requests, answered, wire.service)


def client(ends: Ends, wire: ServiceWire) -> Caller:
    """Raises ValueError for a `wstring`."""
    request, response = codec(wire.request), codec(wire.response)
    us = _identity("clientid")
    requests = ends.writer(request_name(wire.service), structure(wire.request, before=CALL), _quality(us, request))
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

    def call(message: Any, timeout: float) -> Any:
        deadline = time.monotonic() + timeout
        while not (servers := _readers(requests, "serviceid")) or not replies.get_matched_publications():
            if time.monotonic() >= deadline:
                raise NoAnswer(f"no server within {timeout:g} s")
            time.sleep(_LOOK)
        if not all(servers):
            raise NoAnswer("a server that is not on rmw_cyclonedds; not asked")
        for handle in requests.get_matched_subscriptions():
            if why := asked.refusal(_identity_of(requests, handle, "typehash").partition("=")[2]):
                raise NoAnswer(why)
        number = next(numbers)
        waiting[number] = queue.SimpleQueue()
        try:
            send(requests, _joined((guid, number), request.encode(message)))
            answer = waiting[number].get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            raise NoAnswer(f"no answer within {timeout:g} s") from None
        finally:
            del waiting[number]
        if isinstance(answer, NoAnswer):
            raise answer
        return response.decode(answer)

    ends.listen(replies, replied, wire.service)
    return Caller(request.new, call)


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


def _await_reader(replies: DataWriter, client: str) -> None:
    """A client whose writer we know may have a reader that we do not know yet, and that the reply would miss."""
    deadline = time.monotonic() + _REPLY_READER
    while client not in _readers(replies, "clientid") and time.monotonic() < deadline:
        time.sleep(_LOOK)


def _readers(writer: DataWriter, role: str) -> list[str]:
    """The identities of those who read what we write, empty where one has none."""
    return [_identity_of(writer, handle, role) for handle in writer.get_matched_subscriptions()]


def _identity_of(end: DataReader | DataWriter, handle: int, role: str) -> str:
    try:
        return word_of(said_by(end, handle), role)
    except LookupError:  # gone meanwhile
        return ""


def _meant(ends: Ends, service: str, messages: tuple[Message, ...], made: Codec) -> Identity:
    return Identity(service, messages[-1].name, made.type_hash, ends.tell)
