"""The backend dds: a ROS 2 graph without ROS, by Cyclone DDS with ROS 2's names on the wire.

Source: rmw_cyclonedds, whose names, QoS, type hashes and services these are.
"""

from __future__ import annotations

import os
import threading
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
    domain_without_ros,
    from_bytes,
    wall_clock,
)
from shmgen.bridge.codec.cdr import Codec, codec
from shmgen.bridge.codec.type_identity import TAKES_OURS, Identity
from shmgen.bridge.codec.wire_format import CDR
from shmgen.bridge.dds import services
from shmgen.bridge.dds.dropped import Dropped
from shmgen.bridge.dds.entities import Ends, Peers, Subscription, matches, quality, send
from shmgen.bridge.dds.network import confine, network, sockets
from shmgen.bridge.dds.service_pair import ServiceTransport
from shmgen.bridge.dds.service_transport import chosen
from shmgen.bridge.dds.types import structure, topic_name
from shmgen.bridge.ros2 import actions as ros2_actions

_TOLERANT = (
    '<CycloneDDS><Domain Id="any"><Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>'
    "</Domain></CycloneDDS>"
)
"""What Fast DDS 3 (vendor 1.15; ROS 2 Kilted) says of its types Cyclone takes for invalid, and would not match it;
the type hash tells whether they are ours."""
_CONFIGURED: dict[int, tuple[Domain, Dropped]] = {}


def connect(node: Node) -> Graph:
    """Joins the domain. Raises ValueError for a domain that cannot be, and where there is no network."""
    domain = domain_without_ros(node, "dds")
    joined = network(os.environ, node.largest)
    for note in joined.notes:
        node.tell(f"dds: {note}")
    before = sockets()
    try:
        dropped = _configure(domain, joined.config, node.tell)
        if joined.alone:
            confine(before)
        participant = DomainParticipant(domain, Qos(Policy.EntityName(node.name)))
        if joined.alone:
            confine(before)
    except (DDSException, OSError) as error:
        raise ValueError(f"dds: cannot join domain {domain}: {error}") from error
    ends = Ends(participant, node.tell)
    return Graph(ends, dropped, lambda: chosen(ends, node, domain, joined, os.environ))


class Graph:
    """A `Backend`. In `ros2 topic info -v` its name is `_CREATED_BY_BARE_DDS_APP_`."""

    actions = ros2_actions
    now = staticmethod(wall_clock)

    def __init__(self, ends: Ends, dropped: Dropped, choose: Callable[[], ServiceTransport]) -> None:
        self.undo: list[Callable[[], None]] = []
        self._ends = ends
        self._dropped = dropped
        self._choose = choose
        self._services: ServiceTransport | None = None

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
        hand_over = from_bytes(wire, made.decode, CDR, sink)
        turn = threading.Lock()

        def reject(why: str) -> None:
            with turn:
                sink.reject(why)

        def fail(why: str) -> None:
            with turn:
                sink.refuse(stranger) if (stranger := peers.stranger) else sink.reject(why)

        def take(sample: Any) -> None:
            with turn:
                if why := peers.refusal(reader, sample):
                    sink.refuse(why)
                else:
                    hand_over(sample.cdr)

        def lose(count: int) -> None:
            with turn:
                sink.lose(count)

        self._dropped.calls[name] = reject, fail
        unheard = self._ends.topics.add(Subscription(reader, take, name, wire.queue, lose))
        self.undo += [reader.__del__, lambda: self._dropped.forget(name), unheard]
        return RosSubscription(made.new, lambda: bool(matches(reader)))

    def serve(self, wire: ServiceWire, answer: Answer, refuse: Refuse) -> None:
        """Raises as publisher()."""
        self.undo.append(services.serve(self._transport(), wire, self._ends.tell, answer, refuse))

    def client(self, wire: ServiceWire) -> RosClient:
        """Raises as publisher()."""
        caller, close = services.client(self._transport(), wire, self._ends.tell)
        self.undo.append(close)
        return caller

    def _transport(self) -> ServiceTransport:
        self._services = self._services or self._choose()
        return self._services

    def alive(self) -> bool:
        """Always: nobody in DDS tells a node to end."""
        return True

    def close(self) -> None:
        """Leaves the domain."""
        if self._services:
            self._services.leave()
        self._ends.close()


def _configure(domain: int, config: str, tell: Callable[[str], None]) -> Dropped:
    """Once in a process, as Cyclone has it; of two settings the later counts, which is the user's."""
    if domain not in _CONFIGURED:
        dropped = Dropped(tell)
        with dropped.listens():
            _CONFIGURED[domain] = Domain(domain, f"{config},{_TOLERANT}"), dropped
    return _CONFIGURED[domain][1]


def _quality(wire: Wire, made: Codec) -> Qos:
    return quality(wire.qos, wire.latch, wire.queue, f"typehash={made.type_hash};")
