"""The bridge's ROS 2 over zenoh: topics, and services as queries, with rmw_zenoh's keys, tokens and attachments.

Each topic and service to us has a ring that zenoh puts into and a thread that empties it: a slow one holds up no other,
and what a full ring drops is missing in the numbers that its writer gave.
"""

from __future__ import annotations

import atexit
import itertools
import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import zenoh
import zenoh.ext
from zenoh.handlers import RingChannel

from shmgen.bridge.backend import (
    QUEUE,
    Answer,
    MessageSink,
    NoAnswer,
    Node,
    RateLimitedLog,
    Refuse,
    RosClient,
    RosPublisher,
    RosSubscription,
    ServiceWire,
    Wire,
    await_server,
    domain_without_ros,
    end_at_once,
    from_bytes,
    keep,
    wall_clock,
)
from shmgen.bridge.codec.cdr import codec
from shmgen.bridge.codec.wire_format import CDR
from shmgen.bridge.ros2 import actions as ros2_actions
from shmgen.bridge.zenoh.graph import Graph, Place, attached, attachment, opened, quality, writer
from shmgen.core.type_hash import service_hash

_FAREWELL = 0.4
"""Seconds that all threads together get to finish what they are at."""
_HEARTBEAT = 0.5
"""Seconds until a late subscriber hears that it has missed what is latched; rmw_zenoh's own."""


def connect(node: Node) -> Zenoh:
    """Joins the domain. Raises ValueError for one that cannot be, and for a configuration that zenoh does not take."""
    domain = domain_without_ros(node, "zenoh")
    return Zenoh(Graph(opened(os.environ, node.largest, node.tell), node.name, domain, node.tell))


class Zenoh:
    """A Backend."""

    actions = ros2_actions
    now = staticmethod(wall_clock)

    def __init__(self, graph: Graph) -> None:
        self.undo: list[Callable[[], None]] = []
        self._graph, self._session, self._tell = graph, graph.session, graph.tell
        self._threads: list[threading.Thread] = []
        self._kept: set[Callable[[], None]] = set()

    def publisher(self, wire: Wire) -> RosPublisher:
        made = codec(wire.messages)
        place = Place(wire.topic, wire.type, made.type_hash)
        key, best_effort = self._graph.key(place), wire.qos == "best_effort"
        reliability = zenoh.Reliability.BEST_EFFORT if best_effort else zenoh.Reliability.RELIABLE
        drop = zenoh.CongestionControl.DROP
        if wire.latch:
            heartbeat = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT)
            kept = {"cache": zenoh.ext.CacheConfig(1), "publisher_detection": True, "sample_miss_detection": heartbeat}
            out = zenoh.ext.declare_advanced_publisher(
                self._session, key, reliability=reliability, congestion_control=drop, **kept
            )
        else:
            out = self._session.declare_publisher(key, reliability=reliability, congestion_control=drop)
        name, numbers, turn = writer(), itertools.count(1), threading.Lock()
        peers = self._graph.peers("MS", place, self._graph.identity(place))
        hide = self._graph.show("MP", place, quality(best_effort, wire.latch, 1 if wire.latch else wire.queue))
        self._until_undone(out.undeclare, peers.close, hide)

        def send(data: bytes) -> None:
            with turn:  # in the order of their numbers
                out.put(data, attachment=attachment(next(numbers), name))

        encode = wire.short.out_of_region(CDR, self.now) if wire.short else None
        straight = (lambda payload: send(encode(payload))) if encode else None
        return RosPublisher(made.new, lambda message: send(made.encode(message)), False, straight)

    def subscribe(self, wire: Wire, sink: MessageSink) -> RosSubscription:
        """Hears all that calls the type as we do, whatever it means by it: what is refused is counted, too."""
        made = codec(wire.messages)
        place = Place(wire.topic, wire.type, made.type_hash)
        identity = self._graph.identity(place, wire.accepts_other)
        hand_over = from_bytes(wire, made.decode, CDR, sink)
        newest: dict[bytes, int] = {}

        def take(sample: Any) -> None:
            number, sender = attached(sample)
            before = newest.get(sender, number - 1)
            keep(newest, sender, max(number, before))  # what was latched may come behind what is newer
            if why := identity.refusal(str(sample.key_expr).rpartition("/")[2]):
                sink.refuse(why)
                return
            if number > before + 1:
                sink.lose(number - before - 1)
            hand_over(sample.payload.to_bytes())

        key, ring = self._graph.key(place._replace(hash="*")), RingChannel(wire.queue)
        if wire.latch:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=wire.queue)
            heard = zenoh.ext.declare_advanced_subscriber(self._session, key, ring, history=history)
        else:
            heard = self._session.declare_subscriber(key, ring)
        stop = self._empty(heard, take, wire.topic)
        peers = self._graph.peers("MP", place, identity, sink.meet)
        hide = self._graph.show("MS", place, quality(wire.qos == "best_effort", wire.latch, wire.queue))
        self._until_undone(stop, peers.close, hide)
        return RosSubscription(made.new, lambda: peers.is_any)

    def serve(self, wire: ServiceWire, answer: Answer, refuse: Refuse) -> None:
        request, response = codec(wire.request), codec(wire.response)
        place = Place(wire.service, wire.type, service_hash(wire.request, wire.response))
        key = self._graph.key(place)

        def reply(query: Any) -> None:
            with query, suppress(zenoh.ZError):  # the bridge, or the client, has ended meanwhile
                message = response.new()
                try:
                    answer(request.decode(query.payload.to_bytes() if query.payload else b""), message)
                    query.reply(key, response.encode(message), attachment=attachment(*attached(query)))
                except NoAnswer as error:
                    self._tell(f"{wire.service}: no answer: {error}")
                    query.reply_err(str(error))
                except ValueError as error:
                    refuse(str(error))
                    query.reply_err(str(error))

        def take(query: Any) -> None:
            if wire.at_once:
                threading.Thread(target=reply, args=(query,), daemon=True).start()
            else:
                reply(query)

        def meet(stranger: str) -> None:
            if stranger:
                refuse(stranger)

        heard = self._session.declare_queryable(key, RingChannel(QUEUE), complete=True)
        stop = self._empty(heard, take, wire.service)
        peers = self._graph.peers("SC", place, self._graph.identity(place), meet)
        self._until_undone(stop, peers.close, self._graph.show("SS", place, quality()))

    def client(self, wire: ServiceWire) -> RosClient:
        request, response = codec(wire.request), codec(wire.response)
        place = Place(wire.service, wire.type, service_hash(wire.request, wire.response))
        servers = self._graph.peers("SS", place, self._graph.identity(place))
        self._until_undone(servers.close, self._graph.show("SC", place, quality()))
        key, name, numbers = self._graph.key(place), writer(), itertools.count(1)
        how = {"target": zenoh.QueryTarget.ALL_COMPLETE, "consolidation": zenoh.ConsolidationMode.NONE}

        def is_connected() -> bool:
            return servers.is_any or not self.alive()

        def call(message: Any, timeout: float) -> Any:
            if not servers.is_any and servers.stranger:
                raise NoAnswer(servers.stranger)
            deadline = await_server(is_connected, timeout)
            if not self.alive():
                raise NoAnswer("the bridge ends")
            why, left = "the server has gone", max(0.001, deadline - time.monotonic())
            beside = attachment(next(numbers), name)
            asked = request.encode(message)
            for reply in self._session.get(key, payload=asked, attachment=beside, timeout=left, **how):
                if reply.ok is not None:
                    return response.decode(reply.ok.payload.to_bytes())
                why = reply.err.payload.to_string()
            raise NoAnswer(why if time.monotonic() < deadline else f"no answer within {timeout:g} s")

        return RosClient(request.new, call, is_connected)

    def alive(self) -> bool:
        """Until close(): nobody in zenoh tells a node to end."""
        return not self._session.is_closed()

    def close(self) -> None:
        """Leaves the domain; what waits for an answer has none."""
        self._session.close()
        deadline = time.monotonic() + _FAREWELL
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        if any(thread.is_alive() for thread in self._threads):
            atexit.register(end_at_once)

    def _until_undone(self, *ends: Callable[[], object]) -> None:
        """Keeps what these end: zenoh undeclares what nobody holds."""

        def undo() -> None:
            for end in ends:
                end()
            self._kept.discard(undo)

        self._kept.add(undo)
        self.undo.append(undo)

    def _empty(self, entity: Any, take: Callable[[Any], None], name: str) -> Callable[[], None]:
        """Hands over all that comes, in order, in a thread of its own. Gives what ends both."""
        ring, grumble = entity.handler, RateLimitedLog(name, self._tell)

        def run() -> None:
            while True:
                try:
                    came = ring.recv()
                except zenoh.ZError:  # undeclared
                    return
                try:
                    take(came)
                except Exception as error:  # one message is not worth the topic
                    grumble(error)

        thread = threading.Thread(target=run, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

        def stop() -> None:
            entity.undeclare()
            thread.join(_FAREWELL)
            self._threads.remove(thread)

        return stop
