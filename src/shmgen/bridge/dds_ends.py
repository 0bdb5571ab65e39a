"""Turns names, types and QoS into Cyclone's readers and writers, each reader with a thread of its own.

A thread that waits costs less than Cyclone's listener, for which Python makes a thread state at each message.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, Literal

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

from shmgen.bridge.dds_types import sample
from shmgen.bridge.identity import Identity

Matched = Callable[[Any, int], None]
"""Is called with our end and the handle of a peer of it, as soon as they have found each other."""

_PATIENCE = 10_000_000
"""Nanoseconds a writer may be held up; keep-last writers have not been seen to be."""
_AT_ONCE = 64
"""Samples taken from a reader in one go, or its queue if that is longer."""
_FAREWELL = 0.4
"""Seconds that all threads together get to finish what they are at."""
_COMPLAIN = 10.0
"""Seconds from one line about what a peer sends to the next."""
_FOREVER = 2**63 - 1
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any
_ASKING = threading.Lock()
"""Cyclone's Python puts the QoS of a peer, while it reads it, where all threads do: two at once read each other's."""
_POLICIES = {2: "durability", 4: "deadline", 8: "liveliness", 11: "reliability", 23: "data representation", 24: "type"}
"""By dds_qos_policy_id_t, those of ROS 2 that can stand between two ends."""


def quality(reliability: Literal["reliable", "best_effort"], latch: bool, queue: int, user_data: str) -> Qos:
    """As rmw_cyclonedds sets it, but for the time a writer may be held up, which is for ever there."""
    reliable = Policy.Reliability.Reliable(_PATIENCE)
    policies = [
        reliable if reliability == "reliable" else Policy.Reliability.BestEffort,
        Policy.History.KeepLast(queue),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(user_data.encode()),
    ]
    if latch:
        newest = Policy.DurabilityService(
            cleanup_delay=0,
            history=Policy.History.KeepLast(1),
            max_samples=-1,
            max_instances=-1,
            max_samples_per_instance=-1,
        )
        policies += [Policy.Durability.TransientLocal, newest]
    return Qos(*policies)


class Ends:
    """The readers and writers of one participant."""

    def __init__(self, participant: DomainParticipant, tell: Callable[[str], None]) -> None:
        self.tell = tell
        self._participant = participant
        self._stop = GuardCondition(participant)
        self._closing = False  # said by _stop too; but to ask it each time gives the GIL away
        self._threads: list[threading.Thread] = []

    def writer(self, topic: str, kind: type[Any], qos: Qos, matched: Matched | None = None) -> DataWriter:
        """Of the structure `kind`."""
        listener = self._watch(topic, "offer", matched)
        return DataWriter(self._participant, Topic(self._participant, topic, kind), qos, listener)

    def reader(self, topic: str, kind: type[Any], qos: Qos, matched: Matched | None = None) -> DataReader:
        """Of the structure `kind`; what it takes are objects with `cdr`."""
        without_service = qos - Qos(qos[Policy.DurabilityService]) if Policy.DurabilityService in qos else qos
        return DataReader(
            self._participant,
            Topic(self._participant, topic, kind),
            without_service,
            self._watch(topic, "ask for", matched),
        )

    def listen(
        self,
        reader: DataReader,
        callback: Callable[[Any], None],
        name: str,
        queue: int = _AT_ONCE,
        lose: Callable[[int], None] = lambda count: None,
    ) -> None:
        """Calls `callback` with each sample, in order, in a thread of its own. What it raises is told, not often.

        A reader whose `queue` is found full has lost at least one: Cyclone says neither that nor how many. That is
        told to `lose`, of a queue that is not so short that it may well be full with nothing lost.
        """
        words = (reader, callback, name, queue, lose)
        thread = threading.Thread(target=self._run, args=words, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    def close(self) -> None:
        """Deletes all; for the peers they are gone at once."""
        self._closing = True
        with suppress(DDSException):
            self._stop.set(True)
        deadline = time.monotonic() + _FAREWELL
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        self._participant.__del__()  # there is no other way in Cyclone's Python; what is in it goes with it

    def _run(
        self,
        reader: DataReader,
        callback: Callable[[Any], None],
        name: str,
        queue: int,
        lose: Callable[[int], None],
    ) -> None:
        waiting = WaitSet(self._participant)
        waiting.attach(ReadCondition(reader, _ANY))
        waiting.attach(self._stop)
        complained = -_COMPLAIN
        with suppress(DDSException):  # deleted while a callback took its time
            while not self._closing:
                waiting.wait(_FOREVER)
                samples = reader.take(max(queue, _AT_ONCE))
                if len(samples) >= queue > _AT_ONCE:
                    lose(1)
                for taken in samples:
                    try:
                        if not isinstance(taken, InvalidSample):  # a writer that went
                            callback(taken)
                    except Exception as error:  # one message is not worth the topic
                        if time.monotonic() - complained >= _COMPLAIN:
                            complained = time.monotonic()
                            self.tell(f"{name}: {type(error).__name__}: {error}")

    def _watch(self, name: str, verb: str, matched: Matched | None) -> Listener:
        def told(entity: Any, status: Any) -> None:
            policy = _POLICIES.get(status.last_policy_id, f"policy {status.last_policy_id}")
            self.tell(f"{name}: a peer does not match the {policy} that we {verb}; nothing passes between the two")

        def met(entity: Any, status: Any) -> None:
            if matched and entity and status.current_count_change > 0:  # None: not yet made; asked at its first sample
                handle = status.last_subscription_handle if verb == "offer" else status.last_publication_handle
                matched(entity, handle)

        if verb == "offer":
            return Listener(on_offered_incompatible_qos=told, on_publication_matched=met)
        return Listener(on_requested_incompatible_qos=told, on_subscription_matched=met)


class Peers:
    """Who of the peers of a reader or a writer means by the type what we do."""

    def __init__(self, identity: Identity, refuse: Callable[[str], None]) -> None:
        """`refuse` is told of a peer itself too: of what it sends, Cyclone drops what is too short for our type."""
        self._identity = identity
        self._refuse = refuse
        self._known: dict[int, str] = {}

    def matched(self, entity: Any, handle: int) -> None:
        """A Matched: before anything of the peer comes, and before it can go."""
        self._known[handle] = self._judged(entity, handle)

    def refusal(self, reader: DataReader, sample: Any) -> str:
        """Why a sample may not pass; nothing if it may."""
        handle = sample.sample_info.publication_handle
        if handle not in self._known:
            self._known[handle] = self._judged(reader, handle)
        return self._known[handle]

    def _judged(self, entity: Any, handle: int) -> str:
        try:
            words = said_by(entity, handle)
        except LookupError:
            return "a peer has gone before it could be asked what it means by the type"
        if why := self._identity.refusal(word_of(words, "typehash").partition("=")[2]):
            self._refuse(why)
        return why


def matches(entity: Any) -> list[int]:
    """The handles of the peers of a reader or writer."""
    while True:
        with suppress(IndexError):  # another one came while Cyclone's Python counted them
            reads = isinstance(entity, DataReader)
            return list(entity.get_matched_publications() if reads else entity.get_matched_subscriptions())


def said_by(entity: Any, handle: int) -> list[str]:
    """The words in the user data of a peer of a reader or writer. Raises LookupError if it has gone."""
    reads = isinstance(entity, DataReader)
    with _ASKING:
        endpoint = (entity.get_matched_publication_data if reads else entity.get_matched_subscription_data)(handle)
    if endpoint is None:
        raise LookupError(handle)
    data = endpoint.qos[Policy.Userdata].data if Policy.Userdata in endpoint.qos else b""
    return list(data.decode(errors="replace").split(";"))


def word_of(words: Iterable[str], key: str) -> str:
    """`clientid=1.2` for `clientid`; nothing if it is not among them."""
    return next((word for word in words if word.startswith(f"{key}=")), "")


def send(writer: DataWriter, cdr: bytes) -> None:
    """Waits for nobody: a reliable reader that stands still misses all but the newest of the writer's history."""
    writer.write(sample(writer.data_type, cdr))
