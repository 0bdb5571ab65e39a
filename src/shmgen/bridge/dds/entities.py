"""Cyclone's readers and writers, from names, types and QoS: one thread for all topics, and one for each service.

A thread that waits costs less than Cyclone's listener, for which Python makes a thread state at each message.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
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

from shmgen.bridge.backend import RateLimitedLog, keep
from shmgen.bridge.codec.type_identity import Identity
from shmgen.bridge.dds.types import sample

Matched = Callable[[Any, int, bool], None]
"""Is called with our end and the handle of a peer of it, once they have found (True) or lost each other."""

_PATIENCE = 10_000_000
"""Nanoseconds a writer may be held up; keep-last writers have not been seen to be."""
_AT_ONCE = 64
"""Samples taken from a reader in one go, or its queue if that is longer."""
_FAREWELL = 0.4
"""Seconds that all threads together get to finish what they are at."""
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
        self.participant = participant
        self.closing = False
        self.threads: list[ReaderThread] = []
        self.topics = ReaderThread(self)
        self._named: dict[tuple[str, type[Any]], Topic] = {}

    def writer(self, topic: str, kind: type[Any], qos: Qos, matched: Matched | None = None) -> DataWriter:
        """Of the structure `kind`."""
        listener = self._watch(topic, "offer", matched)
        return DataWriter(self.participant, self._topic(topic, kind), qos, listener)

    def reader(self, topic: str, kind: type[Any], qos: Qos, matched: Matched | None = None) -> DataReader:
        """Of the structure `kind`; what it takes are objects with `cdr`."""
        without_service = qos - Qos(qos[Policy.DurabilityService]) if Policy.DurabilityService in qos else qos
        return DataReader(
            self.participant,
            self._topic(topic, kind),
            without_service,
            self._watch(topic, "ask for", matched),
        )

    def _topic(self, name: str, kind: type[Any]) -> Topic:
        """Once: one that is deleted and made again has Cyclone read memory that is no more."""
        return self._named.get((name, kind)) or self._named.setdefault(
            (name, kind), Topic(self.participant, name, kind)
        )

    def listen(self, reader: DataReader, callback: Callable[[Any], None], name: str) -> Callable[[], None]:
        """Calls `callback` with each sample, in order, in a thread of its own. Gives what ends that."""
        thread = ReaderThread(self)
        thread.add(Subscription(reader, callback, name))
        return thread.stop

    def close(self) -> None:
        """Deletes all; for the peers they are gone at once."""
        self.closing = True
        threads = [*self.threads]
        for thread in threads:
            thread.stop()
        deadline = time.monotonic() + _FAREWELL
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        self.participant.__del__()  # there is no other way in Cyclone's Python; what is in it goes with it

    def _watch(self, name: str, verb: str, matched: Matched | None) -> Listener:
        def told(entity: Any, status: Any) -> None:
            policy = _POLICIES.get(status.last_policy_id, f"policy {status.last_policy_id}")
            self.tell(f"{name}: a peer does not match the {policy} that we {verb}; nothing passes between the two")

        def met(entity: Any, status: Any) -> None:
            if matched and entity and not self.closing:  # None: not yet made; asked at its first sample
                handle = status.last_subscription_handle if verb == "offer" else status.last_publication_handle
                matched(entity, handle, status.current_count_change > 0)

        if verb == "offer":
            return Listener(on_offered_incompatible_qos=told, on_publication_matched=met)
        return Listener(on_requested_incompatible_qos=told, on_subscription_matched=met)


@dataclass(frozen=True, slots=True)
class Subscription:
    """A reader, and what is called with each of its samples, in order.

    A reader whose `queue` is found full has lost at least one: Cyclone says neither that nor how many. That is told to
    `lose`, of a queue that is not so short that it may well be full with nothing lost.
    """

    reader: DataReader
    callback: Callable[[Any], None]
    name: str
    queue: int = _AT_ONCE
    lose: Callable[[int], None] = lambda count: None


class ReaderThread:
    """A thread that hears all readers it is given, and tells what their callbacks raise, not often.

    One for many: ten samples that come at once wake it once, and are taken without ten threads asking for the GIL.
    """

    def __init__(self, ends: Ends) -> None:
        self._ends = ends
        self._waiting: _Waiting | None = None

    def add(self, heard: Subscription) -> Callable[[], None]:
        """From any thread but its own. Gives what takes it away again."""
        if not self._waiting:
            self._waiting = _Waiting(self._ends.participant)
            self._thread = threading.Thread(target=self._run, args=(self._waiting,), name=heard.name, daemon=True)
            self._ends.threads.append(self)
            self._thread.start()
        return self._waiting.add(heard.reader, heard, RateLimitedLog(heard.name, self._ends.tell))

    def stop(self) -> None:
        """Ends the thread, from any: its turn is its last."""
        if self._waiting:
            self._waiting.stop()

    def join(self, timeout: float) -> None:
        self._thread.join(timeout)

    def _run(self, waiting: _Waiting) -> None:
        with suppress(DDSException):  # deleted while a callback took its time
            while not waiting.stopped:
                for heard, grumble in waiting.which():
                    self._take(heard, grumble)
        self._ends.threads.remove(self)
        waiting.close()

    def _take(self, heard: Subscription, grumble: RateLimitedLog) -> None:
        try:
            samples = heard.reader.take(max(heard.queue, _AT_ONCE))
        except DDSException:  # it was removed meanwhile
            return
        if len(samples) >= heard.queue > _AT_ONCE:
            heard.lose(1)
        for taken in samples:
            try:
                if not isinstance(taken, InvalidSample):  # a writer that went
                    heard.callback(taken)
            except Exception as error:  # one message is not worth the topic
                grumble(error)


class _Waiting(WaitSet):  # type: ignore[misc]
    """Tells which of what was added has come, where Cyclone's own tells how many: nobody has to be asked in vain."""

    def __init__(self, participant: DomainParticipant) -> None:
        super().__init__(participant)
        self._added: dict[int | None, tuple[Subscription, RateLimitedLog]] = {}
        self._came = (ctypes.c_void_p * 0)()
        self.stopped = False  # said by the condition too; but to ask it each time gives the GIL away
        self._stop = GuardCondition(participant)
        self.attach(self._stop)

    def add(self, reader: DataReader, *what: Any) -> Callable[[], None]:
        """From any thread, as what takes it away again."""
        condition = ReadCondition(reader, _ANY)
        self.attach(condition)
        place = ctypes.addressof(self.attached[-1][1])
        self._added[place] = what

        def remove() -> None:
            del self._added[place]
            with suppress(DDSException):
                self.detach(condition)
            condition.__del__()  # Cyclone's Python keeps all entities until then

        return remove

    def stop(self) -> None:
        self.stopped = True
        with suppress(DDSException):
            self._stop.set(True)

    def which(self) -> list[tuple[Subscription, RateLimitedLog]]:
        """In the order they were added in. Waits until there is one, or stop()."""
        if len(self._came) < len(self.attached):
            self._came = (ctypes.c_void_p * len(self.attached))()
        count = self._waitset_wait(self._ref, self._came, len(self._came), _FOREVER)
        if count < 0:
            raise DDSException(count, "while waiting for samples")
        found = map(self._added.get, self._came[:count])
        return [what for what in found if what]  # else: next time, or removed meanwhile

    def close(self) -> None:
        for entity in (*(entity for entity, _ in self.attached), self):
            entity.__del__()


class Peers:
    """Who of the peers of a reader or a writer means by the type what we do."""

    def __init__(self, identity: Identity, meet: Callable[[str], None] = lambda why: None) -> None:
        """`meet` is told why one that is there may not be heard; nothing, as soon as all may."""
        self._identity = identity
        self._meet = meet
        self._known: dict[int, str] = {}
        self._strangers: dict[int, str] = {}

    def matched(self, entity: Any, handle: int, is_there: bool = True) -> None:
        """A Matched: before anything of the peer comes, and before it can go; and when it has gone."""
        if not is_there:
            self._strangers.pop(handle % 2**64, None)
        elif why := self._remember(entity, handle):
            self._strangers[handle % 2**64] = why
        self._meet(self.stranger)

    @property
    def stranger(self) -> str:
        """Why one that is there now may not be heard; nothing if all may."""
        return next(iter(tuple(self._strangers.values())), "")

    def refusal(self, reader: DataReader, sample: Any) -> str:
        """Why a sample may not pass; nothing if it may."""
        handle = sample.sample_info.publication_handle
        known = self._known.get(handle % 2**64)
        return self._remember(reader, handle) if known is None else known

    def _remember(self, entity: Any, handle: int) -> str:
        why = self._judged(entity, handle)
        keep(self._known, handle % 2**64, why)
        return why

    def _judged(self, entity: Any, handle: int) -> str:
        try:
            words = said_by(entity, handle)
        except LookupError:
            return "a peer has gone before it could be asked what it means by the type"
        return self._identity.refusal(word_of(words, "typehash").partition("=")[2])


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
