"""Turns topics and services into those of a ROS 2 graph without ROS: Cyclone DDS, with ROS 2's names on the wire.

Source: rmw_cyclonedds, whose names, QoS, type hashes and services these are.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.qos import Policy, Qos

from shmgen.bridge.backend import (
    Answer,
    MessageSink,
    Node,
    Refuse,
    RosClient,
    RosPublisher,
    RosSubscription,
    ServiceWire,
    Wire,
)
from shmgen.bridge.codec.cdr import Codec, codec
from shmgen.bridge.codec.type_identity import TAKES_OURS, Identity
from shmgen.bridge.codec.wire_format import CDR
from shmgen.bridge.dds import services
from shmgen.bridge.dds.dropped import Dropped
from shmgen.bridge.dds.entities import Ends, Peers, Subscription, matches, quality, send
from shmgen.bridge.dds.network import confine, network, sockets
from shmgen.bridge.dds.service_transport import ServiceTransports, chosen
from shmgen.bridge.dds.types import structure, topic_name
from shmgen.bridge.ros2 import actions as ros2_actions
from shmgen.runtime import Time

_LAST_DOMAIN = 232
"""Those above have no UDP ports left (DDSI-RTPS 2.5, 9.6.2)."""
_TOLERANT = (
    '<CycloneDDS><Domain Id="any"><Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>'
    "</Domain></CycloneDDS>"
)
"""What Fast DDS 3 (vendor 1.15; ROS 2 Kilted) says of its types Cyclone takes for invalid, and would not match it;
the type hash tells whether they are ours."""
_CONFIGURED: dict[int, tuple[Domain, Dropped]] = {}


def connect(node: Node) -> Graph:
    """Joins the domain. Raises ValueError for a domain that cannot be, and where there is no network."""
    domain = _domain(node.domain)
    if node.arguments:
        node.tell(f"dds: there is no ROS here to take {' '.join(node.arguments)}")
    joined = network(os.environ, node.largest)
    for note in joined.notes:
        node.tell(f"dds: {note}")
    before = sockets()
    try:
        dropped = _configure(domain, joined.config)
        if joined.alone:
            confine(before)
        participant = DomainParticipant(domain, Qos(Policy.EntityName(node.name)))
        if joined.alone:
            confine(before)
    except (DDSException, OSError) as error:
        raise ValueError(f"dds: cannot join domain {domain}: {error}") from error
    ends = Ends(participant, node.tell)
    ways = ServiceTransports(lambda ended: chosen(ends, node, domain, joined, os.environ, ended), node.tell)
    return Graph(ends, dropped, ways)


class Graph:
    """A `Backend`. In `ros2 topic info -v` its name is `_CREATED_BY_BARE_DDS_APP_`."""

    actions = ros2_actions

    def __init__(self, ends: Ends, dropped: Dropped, ways: ServiceTransports) -> None:
        self.undo: list[Callable[[], None]] = []
        self._ends = ends
        self._dropped = dropped
        self._ways = ways

    def publisher(self, wire: Wire) -> RosPublisher:
        """Advertises the topic. Raises ValueError for a type with a `wstring`."""
        made = codec(wire.messages)
        identity = Identity(wire.topic, wire.type, made.type_hash, self._ends.tell, then=TAKES_OURS)
        peers = Peers(identity)
        name, kind = topic_name(wire.topic), structure(wire.messages)
        writer = self._ends.writer(name, kind, _quality(wire, made), peers.matched)
        self.undo.append(writer.__del__)
        for handle in matches(writer):  # those of whom nobody was told while it was made
            peers.matched(writer, handle)
        encode = wire.short.out_of_region(CDR, self.now) if wire.short else None
        straight = (lambda payload: send(writer, encode(payload))) if encode else None
        return RosPublisher(made.new, lambda message: send(writer, made.encode(message)), False, straight)

    def subscribe(self, wire: Wire, sink: MessageSink) -> RosSubscription:
        """Hands over in the thread of all topics. Raises as publisher()."""
        made = codec(wire.messages)
        name = topic_name(wire.topic)
        identity = Identity(wire.topic, wire.type, made.type_hash, self._ends.tell, wire.accepts_other)
        peers = Peers(identity, sink.meet)
        reader = self._ends.reader(name, structure(wire.messages), _quality(wire, made), peers.matched)
        for handle in matches(reader):  # those of whom nobody was told while it was made
            peers.matched(reader, handle)
        straight = wire.short.into_region(CDR) if wire.short else None
        turn = threading.Lock()

        def reject(why: str) -> None:
            with turn:
                sink.reject(why)

        def fail(why: str) -> None:
            with turn:
                sink.refuse(stranger) if (stranger := peers.stranger) else sink.reject(why)

        def take(sample: Any) -> None:
            with turn:
                judge(sample)

        def judge(sample: Any) -> None:
            if why := peers.refusal(reader, sample):
                sink.refuse(why)
                return
            if len(sample.cdr) > wire.largest:
                sink.reject(f"{len(sample.cdr):,} bytes, and more than {wire.largest:,} are no message for its region")
                return
            try:
                message = (straight and straight(sample.cdr)) or made.decode(sample.cdr)
            except ValueError as error:
                sink.reject(str(error))
                return
            sink.take(message)

        def lose(count: int) -> None:
            with turn:
                sink.lose(count)

        self._dropped.tell(name, reject, fail)
        self._ends.topics.add(Subscription(reader, take, name, wire.queue, lose))
        self.undo += [reader.__del__, lambda: self._dropped.forget(name)]
        return RosSubscription(made.new, lambda: bool(matches(reader)))

    def serve(self, wire: ServiceWire, answer: Answer, refuse: Refuse) -> None:
        """Soon. Raises as publisher()."""
        self.undo.append(services.serve(self._ways.opened, wire, self._ends.tell, answer, refuse))

    def client(self, wire: ServiceWire) -> RosClient:
        """Raises as publisher()."""
        caller, close = services.client(self._ways.opened, wire, self._ends.tell)
        self.undo.append(close)
        return caller

    def now(self) -> Time:
        """The wall's clock."""
        return Time(*divmod(time.time_ns(), 10**9))

    def alive(self) -> bool:
        """Always: nobody in DDS tells a node to end."""
        return True

    def close(self) -> None:
        """Leaves the domain."""
        self._ways.leave()
        self._ends.close()


def _configure(domain: int, config: str) -> Dropped:
    """Once in a process, as Cyclone has it; of two settings the later counts, which is the user's."""
    if domain not in _CONFIGURED:
        dropped = Dropped()
        _CONFIGURED[domain] = Domain(domain, f"{dropped.config},{config},{_TOLERANT}"), dropped
    return _CONFIGURED[domain][1]


def _domain(configured: int | None) -> int:
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() if configured is None else str(configured)
    if not text:
        return 0
    if not text.isdecimal() or int(text) > _LAST_DOMAIN:
        where = "ROS_DOMAIN_ID" if configured is None else "shmgen.toml"
        raise ValueError(f"dds: a domain is a number from 0 to {_LAST_DOMAIN}, not {text!r} as {where} says")
    return int(text)


def _quality(wire: Wire, made: Codec) -> Qos:
    return quality(wire.qos, wire.latch, wire.queue, f"typehash={made.type_hash};")
