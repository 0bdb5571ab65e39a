"""Creates Cyclone's readers and writers, and threads that read, which cost less than Cyclone's listeners."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import (
    DDSException,
    GuardCondition,
    InstanceState,
    Listener,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from shmgen.bridge.common import qos
from shmgen.bridge.common.peers import Peers
from shmgen.bridge.common.support import guarded, join_all
from shmgen.bridge.dds.types import sample

Matched = Callable[[Any, int, bool], None]
"""A callback for a matched or lost peer: our reader or writer, the peer's handle, and True if the peer matched."""

_MAX_BLOCKING_TIME = 10_000_000
"""Maximum nanoseconds that a write may block. Keep-last writers were never observed to block."""
_BATCH = 64
"""Number of samples to take from a reader in one call. If the reader's queue is longer, its length is taken instead."""
_FOREVER = 2**63 - 1
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any
_QOS_LOCK = threading.Lock()
"""Held while the QoS of a peer is read, because Cyclone's Python binding reads into a buffer that all threads share."""
_DURABILITY, _RELIABILITY = 2, 11
"""Numbers of two policies in dds_qos_policy_id_t."""
_POLICIES = {4: "deadline", 8: "liveliness", 23: "data representation", 24: "type"}
"""Other policies of ROS 2 that can prevent a match, by their number in dds_qos_policy_id_t."""
_MOST_ENDS = 10_000
"""Maximum number of endpoints of a domain to examine."""


def quality(policies: qos.Qos, queue: int, user_data: str) -> Qos:
    """Return the QoS that rmw_cyclonedds would set, plus a limit of the time for which a write may block."""
    entries = [
        Policy.Reliability.Reliable(_MAX_BLOCKING_TIME) if policies.reliable else Policy.Reliability.BestEffort,
        Policy.History.KeepLast(queue),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(user_data.encode()),
    ]
    if policies.latched:
        newest = Policy.DurabilityService(
            cleanup_delay=0,
            history=Policy.History.KeepLast(1),
            max_samples=-1,
            max_instances=-1,
            max_samples_per_instance=-1,
        )
        entries += [Policy.Durability.TransientLocal, newest]
    return Qos(*entries)


class Ends:
    """Creates and owns the readers and writers of the bridge's participant in Cyclone DDS."""

    def __init__(self, participant: DomainParticipant, log: Callable[[str], None]) -> None:
        self.log = log
        self.participant = participant
        self.closing = False
        self.threads: list[ReaderThread] = []
        self._topics_by_name: dict[tuple[str, type[Any]], Topic] = {}
        self._incompatible: set[tuple[str, bool]] = set()
        """Topics with an incompatible QoS that Cyclone reported. The bool is True if the peer publishes."""
        self._endpoints = {
            publishes: BuiltinDataReader(participant, topic)
            for publishes, topic in ((True, BuiltinTopicDcpsPublication), (False, BuiltinTopicDcpsSubscription))
        }

    @cached_property
    def topics(self) -> ReaderThread:
        """The thread that serves all topics. It starts with the first subscription."""
        return ReaderThread(self, "topics")

    def writer(self, topic: str, kind: type[Any], quality: Qos, matched: Matched | None = None) -> DataWriter:
        """Create a writer for samples of the structure `kind`. `matched` is called for peers that match or leave."""
        listener = self._watch(topic, "offers", matched)
        return DataWriter(self.participant, self._topic(topic, kind), quality, listener)

    def reader(self, topic: str, kind: type[Any], quality: Qos, matched: Matched | None = None) -> DataReader:
        """Create a reader for samples of the structure `kind`, with the received bytes as `cdr`. See writer()."""
        has_service = Policy.DurabilityService in quality
        without_service = quality - Qos(quality[Policy.DurabilityService]) if has_service else quality
        listener = self._watch(topic, "requests", matched)
        return DataReader(self.participant, self._topic(topic, kind), without_service, listener)

    def _topic(self, name: str, kind: type[Any]) -> Topic:
        """Return the DDS topic `name`, created once. If it were created again, Cyclone would read freed memory."""
        return self._topics_by_name.get((name, kind)) or self._topics_by_name.setdefault(
            (name, kind), Topic(self.participant, name, kind)
        )

    def close(self) -> None:
        """Delete all readers and writers. Peers see at once that the readers and writers are gone."""
        self.closing = True
        threads = [*self.threads]
        for thread in threads:
            thread.stop()
        join_all(reader_thread.thread for reader_thread in threads)
        self.participant.__del__()  # the only way in Python; deletes all readers and writers too

    def peers_qos(self, topic: str, publishes: bool) -> list[qos.Qos]:
        """Return the QoS of all publishers of a topic if `publishes` is True, or else of all its subscribers.

        A search examines all endpoints of the domain. Therefore search only if Cyclone has reported an incompatible QoS
        on this topic, and return an empty list in all other cases.
        """
        if (topic, publishes) not in self._incompatible:
            return []
        with _QOS_LOCK:
            ends = self._endpoints[publishes].read(_MOST_ENDS)
        alive = [end for end in ends if end.sample_info.instance_state == InstanceState.Alive]
        peers = [_policies(end.qos) for end in alive if end.topic_name == topic]
        if not peers:
            self._incompatible.discard((topic, publishes))
        return peers

    def _watch(self, name: str, verb: str, matched: Matched | None) -> Listener:
        def report_incompatible(entity: Any, status: Any) -> None:
            if status.last_policy_id in (_DURABILITY, _RELIABILITY):
                self._incompatible.add((name, verb != "offers"))  # peers_qos() finds the peer
                return
            policy = _POLICIES.get(status.last_policy_id, f"policy {status.last_policy_id}")
            self.log(f"{name}: a peer's {policy} is incompatible with the bridge's; no messages pass between the two")

        def report_match(entity: Any, status: Any) -> None:
            if matched and entity and not self.closing:  # None: still being created; the first sample checks the peer
                handle = status.last_subscription_handle if verb == "offers" else status.last_publication_handle
                matched(entity, handle, status.current_count_change > 0)

        if verb == "offers":
            return Listener(on_offered_incompatible_qos=report_incompatible, on_publication_matched=report_match)
        return Listener(on_requested_incompatible_qos=report_incompatible, on_subscription_matched=report_match)


@dataclass(frozen=True, slots=True)
class Subscription:
    """A reader, and the callback that receives its samples in order.

    Cyclone does not report lost samples. If the reader's queue is full, take() assumes that one sample was lost, and
    calls `lose(1)`. Queues of 64 samples or fewer are not checked, because a short queue is often full without a loss.
    """

    reader: DataReader
    callback: Callable[[Any], None]
    name: str
    queue: int = _BATCH
    lose: Callable[[int], None] = lambda count: None

    def take(self) -> None:
        """Take the present samples and pass them to the callback."""
        try:
            samples = self.reader.take(max(self.queue, _BATCH))
        except DDSException:  # the reader was removed meanwhile
            return
        if len(samples) >= self.queue > _BATCH:
            self.lose(1)
        for received in samples:
            if not isinstance(received, InvalidSample):  # a notice that the writer has left
                self.callback(received)


class ReaderThread(WaitSet):  # type: ignore[misc]
    """A thread that takes the samples of many readers and calls the callback of each reader.

    Ten samples that arrive together wake the thread once, and no threads compete for the GIL. The class extends
    Cyclone's wait set, which returns only the number of readers with new samples, to find these readers.
    """

    def __init__(self, ends: Ends, name: str) -> None:
        super().__init__(ends.participant)
        self._ends = ends
        self._added: dict[int | None, Subscription] = {}
        self._triggered = (ctypes.c_void_p * 0)()
        self._stopped = False  # duplicates _stop, because reading a condition releases the GIL
        self._stop = GuardCondition(ends.participant)
        self.attach(self._stop)
        self.thread = threading.Thread(target=self._run, name=name, daemon=True)
        ends.threads.append(self)
        self.thread.start()

    def add(self, subscription: Subscription) -> Callable[[], None]:
        """Add a reader, and return a function that removes the reader. Do not call these functions in a callback."""
        callback = guarded(subscription.callback, subscription.name, self._ends.log)
        condition = ReadCondition(subscription.reader, _ANY)
        self.attach(condition)
        place = ctypes.addressof(self.attached[-1][1])
        self._added[place] = replace(subscription, callback=callback)

        def remove() -> None:
            del self._added[place]
            with suppress(DDSException):
                self.detach(condition)
            condition.__del__()  # otherwise Cyclone's Python binding keeps the condition for ever

        return remove

    def stop(self) -> None:
        """Stop the thread after it has taken the present samples. Thread-safe."""
        self._stopped = True
        with suppress(DDSException):
            self._stop.set(True)

    def _run(self) -> None:
        with suppress(DDSException):  # the entities were deleted during a callback
            while not self._stopped:
                for subscription in self._wait_for_samples():
                    subscription.take()
        self._ends.threads.remove(self)
        for entity in (*(entity for entity, _ in self.attached), self):
            entity.__del__()

    def _wait_for_samples(self) -> list[Subscription]:
        """Wait until a reader has new samples or stop() is called. Return the subscriptions with new samples."""
        if len(self._triggered) < len(self.attached):
            self._triggered = (ctypes.c_void_p * len(self.attached))()
        count = self._waitset_wait(self._ref, self._triggered, len(self._triggered), _FOREVER)
        if count < 0:
            raise DDSException(count, "while waiting for samples")
        subscriptions = map(self._added.get, self._triggered[:count])
        return [one for one in subscriptions if one]  # None: the stop condition, or a reader being added or removed


def update_peer(peers: Peers, entity: Any, handle: int, is_there: bool = True) -> None:
    """Add the peer `handle` of `entity`, a reader or writer, to `peers`. Remove the peer if `is_there` is False."""
    if not is_there:
        peers.remove(key_of(handle))
        return
    with suppress(LookupError):  # the peer has left meanwhile
        peers.add(key_of(handle), entries_of(user_data_of(entity, handle)).get("typehash", ""))


def refusal(peers: Peers, reader: DataReader, sample: Any) -> str:
    """Return why a sample of an incompatible peer must be refused, or `""` if the sample may pass."""
    handle = sample.sample_info.publication_handle
    if not peers.knows(key_of(handle)):
        update_peer(peers, reader, handle)
    return peers.refusal(key_of(handle))


def key_of(handle: int) -> int:
    """Return a handle as an unsigned number. Cyclone's Python binding reports some handles as negative numbers."""
    return handle % 2**64


def _policies(end: Qos) -> qos.Qos:
    """Return the QoS policies of a peer's reader or writer."""
    is_reliable = isinstance(end[Policy.Reliability], Policy.Reliability.Reliable)
    return qos.Qos(is_reliable, Policy.Durability in end and end[Policy.Durability] != Policy.Durability.Volatile)


def matches(entity: Any) -> list[int]:
    """Return the handles of all peers that match a reader or writer."""
    while True:
        with suppress(IndexError):  # another peer matched while Cyclone's Python binding counted; retry
            reads = isinstance(entity, DataReader)
            return list(entity.get_matched_publications() if reads else entity.get_matched_subscriptions())


def user_data_of(entity: Any, handle: int) -> list[str]:
    """Return the parts, separated by `;`, of the user data of a peer. Raises LookupError if the peer has left."""
    reads = isinstance(entity, DataReader)
    with _QOS_LOCK:
        endpoint = (entity.get_matched_publication_data if reads else entity.get_matched_subscription_data)(handle)
    if endpoint is None:
        raise LookupError(handle)
    data = endpoint.qos[Policy.Userdata].data if Policy.Userdata in endpoint.qos else b""
    return list(data.decode(errors="replace").split(";"))


def entries_of(parts: Iterable[str]) -> dict[str, str]:
    """Return the entries of a peer's user data from its parts, such as `clientid=1.2`."""
    return {key: value for key, _, value in (part.partition("=") for part in parts)}


def is_acknowledged(writer: DataWriter, seconds: float) -> bool:
    """Return True if all reliable readers acknowledge all samples within `seconds`. Cyclone's own method raises."""
    return bool(writer._wait_for_acks(writer._ref, int(seconds * 1e9)) == 0)


def send(writer: DataWriter, cdr: bytes) -> None:
    """Write a sample without waiting for readers. A reliable reader that is too slow then misses the oldest samples."""
    writer.write(sample(writer.data_type, cdr))
