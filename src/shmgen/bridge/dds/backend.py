"""The backend dds: a node in a ROS 2 graph through Cyclone DDS, with the names and QoS of rmw_cyclonedds."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.qos import Policy, Qos

from shmgen.bridge.backend import (
    Answer,
    Backend,
    ErrorSink,
    Node,
    RosClient,
    RosPublisher,
    RosSubscription,
    ServiceWire,
    Wire,
)
from shmgen.bridge.codec.cdr import Codec, codec
from shmgen.bridge.codec.type_identity import TAKES_OURS, Identity
from shmgen.bridge.common import qos
from shmgen.bridge.common.peers import Peers
from shmgen.bridge.common.support import domain_without_ros, from_bytes, sample_sender
from shmgen.bridge.dds.dropped import Dropped
from shmgen.bridge.dds.entities import Ends, Subscription, is_acknowledged, matches, quality, refusal, send, update_peer
from shmgen.bridge.dds.network import confine, network, sockets
from shmgen.bridge.dds.service_pair import ServiceTransport
from shmgen.bridge.dds.service_transport import chosen
from shmgen.bridge.dds.services import Client, Server
from shmgen.bridge.dds.types import structure, topic_name
from shmgen.bridge.ros2 import actions as ros2_actions

_TOLERANT = (
    '<CycloneDDS><Domain Id="any"><Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>'
    "</Domain></CycloneDDS>"
)
"""Makes Cyclone ignore the type information of Fast DDS 3 (Kilted), which Cyclone would reject. Type hashes decide."""
_CONFIGURED: dict[int, tuple[Domain, Dropped]] = {}
"""The configured domains of this process, by number."""


def connect(node: Node) -> Graph:
    """Join the DDS domain of `node`. Raises ValueError if the domain number is invalid or Cyclone cannot join."""
    domain = domain_without_ros(node, "dds")
    joined = network(os.environ, node.largest)
    for note in joined.notes:
        node.log(f"dds: {note}")
    before = sockets()
    try:
        dropped = _configure(domain, joined.config, node.log)
        if joined.alone:
            confine(before)
        participant = DomainParticipant(domain, Qos(Policy.EntityName(node.name)))
        if joined.alone:
            confine(before)
    except (DDSException, OSError) as error:
        raise ValueError(f"dds: cannot join domain {domain}: {error}") from error
    ends = Ends(participant, node.log)
    return Graph(ends, dropped, lambda: chosen(ends, node, domain, joined, os.environ))


class Graph(Backend):
    """The Backend for DDS: a participant in a domain. `ros2 topic info -v` names it `_CREATED_BY_BARE_DDS_APP_`."""

    actions = ros2_actions

    def __init__(self, ends: Ends, dropped: Dropped, choose: Callable[[], ServiceTransport]) -> None:
        super().__init__()
        self._ends = ends
        self._dropped = dropped
        self._choose = choose
        self._services: ServiceTransport | None = None

    def publisher(self, wire: Wire) -> RosPublisher:
        """Create a publisher of the topic. Raises ValueError if the type contains a `wstring`."""
        cdr = codec(wire.messages)
        identity = Identity(wire.name, wire.type, cdr.type_hash, self._ends.log, then=TAKES_OURS)
        matched = partial(update_peer, Peers(identity))
        name, kind = topic_name(wire.name), structure(wire.messages)
        own = qos.ours(wire)
        writer = self._ends.writer(name, kind, _quality(own, wire, cdr), matched)
        self.undo.append(writer.__del__)
        for handle in matches(writer):  # peers that matched before the writer was returned
            matched(writer, handle)
        send_sample = sample_sender(wire, self.now, partial(send, writer))
        acknowledged = partial(is_acknowledged, writer)

        def qos_problem() -> str:
            return qos.problem(own, self._ends.peers_qos(name, publishes=False), publishes=True)

        return RosPublisher(
            cdr.new, lambda message: send(writer, cdr.encode(message)), send_sample, acknowledged, qos_problem
        )

    def subscribe(self, wire: Wire, take: Callable[[Any], None], errors: ErrorSink) -> RosSubscription:
        """Subscribe to the topic. One thread serves all topics. Raises ValueError if the type contains a `wstring`."""
        cdr = codec(wire.messages)
        name = topic_name(wire.name)
        identity = Identity(wire.name, wire.type, cdr.type_hash, self._ends.log, wire.accepts_other)
        deliver = from_bytes(wire, cdr.decode, take, errors)

        def fail(why: str) -> None:
            errors.refuse(peer) if (peer := subscription.end[1].incompatible_peer) else errors.reject(why)

        def create(policies: qos.Qos) -> tuple[tuple[Any, Peers], qos.Qos, Callable[[], None]]:
            peers = Peers(identity, errors.set_incompatible_peer)
            matched = partial(update_peer, peers)

            def receive(sample: Any) -> None:
                if why := refusal(peers, reader, sample):
                    errors.refuse(why)
                else:
                    deliver(sample.cdr)

            def undo() -> None:
                unheard()
                reader.__del__()

            reader = self._ends.reader(name, structure(wire.messages), _quality(policies, wire, cdr), matched)
            for handle in matches(reader):  # peers that matched before the reader was returned
                matched(reader, handle)
            unheard = self._ends.topics.add(Subscription(reader, receive, name, wire.queue, errors.lose))
            return (reader, peers), policies, undo

        subscription = qos.AdoptingSubscription(wire, create, lambda: self._ends.peers_qos(name, publishes=True))
        self._dropped.calls[name] = errors.reject, fail
        self.undo += [lambda: self._dropped.calls.pop(name, None), subscription.undo]
        return RosSubscription(cdr.new, lambda: bool(matches(subscription.end[0])), subscription.qos_problem)

    def serve(self, wire: ServiceWire, answer: Answer, errors: ErrorSink) -> None:
        """Offer the service. Raises ValueError if the type contains a `wstring`."""
        self.undo.append(Server(self._transport(), wire, self._ends.log, errors, answer).close)

    def client(self, wire: ServiceWire) -> RosClient:
        """Create a client of the service. Raises ValueError if the type contains a `wstring`."""
        client = Client(self._transport(), wire, self._ends.log)
        self.undo.append(client.close)
        return RosClient(client.request.new, client.call, client.is_connected)

    def _transport(self) -> ServiceTransport:
        self._services = self._services or self._choose()
        return self._services

    def close(self) -> None:
        """Leave the DDS domain."""
        if self._services:
            self._services.leave()
        self._ends.close()


def _configure(domain: int, config: str, log: Callable[[str], None]) -> Dropped:
    """Create the Cyclone domain, once in a process, and return the object that reads its log lines."""
    if domain not in _CONFIGURED:
        dropped = Dropped(log)
        with dropped.listens():
            _CONFIGURED[domain] = Domain(domain, f"{config},{_TOLERANT}"), dropped
    return _CONFIGURED[domain][1]


def _quality(policies: qos.Qos, wire: Wire, cdr: Codec) -> Qos:
    return quality(policies, wire.queue, f"typehash={cdr.type_hash};")
