"""The backend zenoh: topics, and services as queries, with the keys, tokens and attachments of rmw_zenoh.

Each subscription and server has a ring buffer that zenoh fills and a thread that empties it. A slow topic therefore
delays no other topic. If a full ring drops a message, the gap in the writer's sequence numbers reveals the loss.
"""

from __future__ import annotations

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
    Backend,
    ErrorSink,
    NoAnswer,
    Node,
    RosClient,
    RosPublisher,
    RosSubscription,
    ServiceWire,
    Wire,
)
from shmgen.bridge.codec.cdr import codec
from shmgen.bridge.codec.type_identity import Identity
from shmgen.bridge.common.peers import Peers
from shmgen.bridge.common.support import (
    SHUTDOWN_TIMEOUT,
    await_server,
    domain_without_ros,
    from_bytes,
    guarded,
    join_all,
    remember_bounded,
    sample_sender,
)
from shmgen.bridge.ros2 import actions as ros2_actions
from shmgen.bridge.zenoh.graph import Graph, Place, attachment, open_session, parse_attachment, quality
from shmgen.core.type_hash import service_hash

_HEARTBEAT = 0.5
"""Seconds until a late subscriber detects that it missed the latched message. rmw_zenoh uses the same value."""


def connect(node: Node) -> Zenoh:
    """Join the ROS domain of `node`. Raises ValueError if the domain number or zenoh's configuration is invalid."""
    domain = domain_without_ros(node, "zenoh")
    name = f"{node.namespace.replace('/', '%')}/{node.name}"
    return Zenoh(Graph(open_session(os.environ, node.largest, node.log), name, domain, node.log))


class Zenoh(Backend):
    """The bridge's node in a ROS 2 graph of rmw_zenoh, with the interface of a Backend."""

    actions = ros2_actions

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self._graph, self._session, self._log = graph, graph.session, graph.log
        self._threads: list[threading.Thread] = []
        self._undo_functions: set[Callable[[], None]] = set()

    def publisher(self, wire: Wire) -> RosPublisher:
        cdr = codec(wire.messages)
        place = Place(wire.name, wire.type, cdr.type_hash)
        key, best_effort = self._graph.key(place), wire.qos == "best_effort"
        reliability = zenoh.Reliability.BEST_EFFORT if best_effort else zenoh.Reliability.RELIABLE
        how: dict[str, Any] = {"reliability": reliability, "congestion_control": zenoh.CongestionControl.DROP}
        if wire.latch:
            how["sample_miss_detection"] = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT)
            cache = zenoh.ext.CacheConfig(1)
            out = zenoh.ext.declare_advanced_publisher(self._session, key, cache=cache, publisher_detection=True, **how)
        else:
            out = self._session.declare_publisher(key, **how)
        numbers, lock = itertools.count(1), threading.Lock()
        end_watch = self._graph.watch("MS", place, Peers(Identity(*place, self._log)))
        token = self._graph.show("MP", place, quality(best_effort, wire.latch, 1 if wire.latch else wire.queue))
        self._until_undone(out.undeclare, end_watch, token.withdraw)

        def send(data: bytes) -> None:
            with lock:  # sends in the order of the numbers
                out.put(data, attachment=attachment(next(numbers), token.gid))

        send_sample = sample_sender(wire, self.now, send)
        return RosPublisher(cdr.new, lambda message: send(cdr.encode(message)), send_sample)

    def subscribe(self, wire: Wire, take: Callable[[Any], None], errors: ErrorSink) -> RosSubscription:
        """Subscribe to all publishers of the topic and type. Refuse and count messages of incompatible publishers."""
        cdr = codec(wire.messages)
        place = Place(wire.name, wire.type, cdr.type_hash)
        identity = Identity(*place, self._log, wire.accepts_other)
        deliver = from_bytes(wire, cdr.decode, take, errors)
        newest: dict[bytes, int] = {}

        def receive(sample: Any) -> None:
            number, sender = parse_attachment(sample)
            before = newest.get(sender, number - 1)
            remember_bounded(newest, sender, max(number, before))  # a latched message may arrive after a newer one
            if why := identity.refusal(str(sample.key_expr).rpartition("/")[2]):
                errors.refuse(why)
                return
            if number > before + 1:
                errors.lose(number - before - 1)
            deliver(sample.payload.to_bytes())

        key, ring = self._graph.key(place._replace(hash="*")), RingChannel(wire.queue)
        if wire.latch:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=wire.queue)
            subscriber = zenoh.ext.declare_advanced_subscriber(self._session, key, ring, history=history)
        else:
            subscriber = self._session.declare_subscriber(key, ring)
        stop = self._empty(subscriber, receive, wire.name)
        peers = Peers(identity, errors.set_incompatible_peer)
        end_watch = self._graph.watch("MP", place, peers)
        token = self._graph.show("MS", place, quality(wire.qos == "best_effort", wire.latch, wire.queue))
        self._until_undone(stop, end_watch, token.withdraw)
        return RosSubscription(cdr.new, lambda: peers.has_compatible)

    def serve(self, wire: ServiceWire, answer: Answer, errors: ErrorSink) -> None:
        request, response = codec(wire.request), codec(wire.response)
        place = Place(wire.name, wire.type, service_hash(wire.request, wire.response))
        key = self._graph.key(place)

        def reply(query: Any) -> None:
            with query, suppress(zenoh.ZError):  # the bridge or the client has left meanwhile
                message = response.new()
                try:
                    answer(request.decode(query.payload.to_bytes() if query.payload else b""), message)
                    query.reply(key, response.encode(message), attachment=attachment(*parse_attachment(query)))
                except NoAnswer as error:
                    self._log(f"{wire.name}: no answer: {error}")
                    query.reply_err(str(error))
                except ValueError as error:
                    errors.refuse(str(error))
                    query.reply_err(str(error))

        def take(query: Any) -> None:
            if wire.at_once:
                threading.Thread(target=guarded(reply, wire.name, self._log), args=(query,), daemon=True).start()
            else:
                reply(query)

        def refuse_peer(incompatible_peer: str) -> None:
            if incompatible_peer:
                errors.refuse(incompatible_peer)

        queryable = self._session.declare_queryable(key, RingChannel(QUEUE), complete=True)
        stop = self._empty(queryable, take, wire.name)
        end_watch = self._graph.watch("SC", place, Peers(Identity(*place, self._log), refuse_peer))
        token = self._graph.show("SS", place, quality())
        self._until_undone(stop, end_watch, token.withdraw)

    def client(self, wire: ServiceWire) -> RosClient:
        request, response = codec(wire.request), codec(wire.response)
        place = Place(wire.name, wire.type, service_hash(wire.request, wire.response))
        servers = Peers(Identity(*place, self._log))
        end_watch = self._graph.watch("SS", place, servers)
        token = self._graph.show("SC", place, quality())
        self._until_undone(end_watch, token.withdraw)
        key, numbers = self._graph.key(place), itertools.count(1)
        how = {"target": zenoh.QueryTarget.ALL_COMPLETE, "consolidation": zenoh.ConsolidationMode.NONE}

        def is_connected() -> bool:
            return servers.has_compatible or not self.alive()

        def call(message: Any, timeout: float) -> Any:
            if not servers.has_compatible and servers.incompatible_peer:
                raise NoAnswer(servers.incompatible_peer)
            deadline = await_server(is_connected, timeout)
            if not self.alive():
                raise NoAnswer("the bridge stops")
            why, left = "the server has left", max(0.001, deadline - time.monotonic())
            beside = attachment(next(numbers), token.gid)
            payload = request.encode(message)
            for reply in self._session.get(key, payload=payload, attachment=beside, timeout=left, **how):
                if reply.ok is not None:
                    return response.decode(reply.ok.payload.to_bytes())
                why = reply.err.payload.to_string()
            raise NoAnswer(why if time.monotonic() < deadline else f"no answer within {timeout:g} s")

        return RosClient(request.new, call, is_connected)

    def alive(self) -> bool:
        """Return True until close() is called. With zenoh, no other program can shut down the node."""
        return not self._session.is_closed()

    def close(self) -> None:
        """Leave the ROS domain. Pending calls end without an answer."""
        self._session.close()
        join_all(self._threads)

    def _until_undone(self, *ends: Callable[[], object]) -> None:
        """Register `ends`, functions that remove an entity. Without these references, zenoh would remove it at once."""

        def undo() -> None:
            for end in ends:
                end()
            self._undo_functions.discard(undo)

        self._undo_functions.add(undo)
        self.undo.append(undo)

    def _empty(self, entity: Any, take: Callable[[Any], None], name: str) -> Callable[[], None]:
        """Call `take` in a thread with each message of `entity`, in order. Return a function that removes `entity`."""
        ring, take = entity.handler, guarded(take, name, self._log)

        def run() -> None:
            while True:
                try:
                    received = ring.recv()
                except zenoh.ZError:  # the entity was removed
                    return
                take(received)

        thread = threading.Thread(target=run, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

        def stop() -> None:
            entity.undeclare()
            thread.join(SHUTDOWN_TIMEOUT)
            self._threads.remove(thread)

        return stop
