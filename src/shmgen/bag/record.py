"""Records live regions: every sample that can be had, in order, with the number and stamp of its writer."""

from __future__ import annotations

import gc
import json
import os
import queue
import struct
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from shmgen.bag.folder import Bag, Channel
from shmgen.bag.kinds import Kind, kind_of
from shmgen.bag.mcap import Chunk
from shmgen.core.diagnostics import Rejected
from shmgen.live import regions
from shmgen.live.classes import ClassRegistry, watcher
from shmgen.live.regions import View, depth_of, sound, topic_of
from shmgen.runtime import Message, ShmError, Subscriber, region_name
from shmgen.runtime.errors import RegionMissing, ValueRejected
from shmgen.runtime.region import header as h
from shmgen.runtime.region.names import HALVES, region_file

_LOOK = 5e-4
"""Seconds between two looks at all regions. One that keeps two samples at 1 kHz has each of them for a millisecond."""
_SEARCH = 0.25
"""Seconds between two searches for regions that have come or gone."""
_AT_ONCE = 5e-3
"""Seconds between two while files in /dev/shm come and go."""
_CHUNK = 1 << 20
"""Bytes after which a chunk goes to the file."""
_FLUSH = 0.5
"""Seconds after which it goes anyway: what SIGKILL costs at most."""
_WAITING = 64 << 20
"""Bytes that may wait for the disk; beyond that samples are left to be overwritten, and counted as missed."""

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Figures:
    """`size` in bytes, `missed` and `damaged` in samples."""

    topics: int
    samples: int
    missed: int
    damaged: int
    size: int


@dataclass(slots=True)
class _Source:
    """A region that is recorded."""

    topic: str
    view: View
    reader: Subscriber[Message]
    kind: Kind
    channel: int
    samples: int = 0
    damaged: int = 0


class Recorder:
    """Looks at the regions in one thread, writes the bag in another."""

    def __init__(self, registry: ClassRegistry, bag: Bag, topics: Collection[str] | None, tell: Tell) -> None:
        """Of `topics`, services and actions with all their halves; None: of all regions that there are and will be."""
        self._registry, self._bag, self._tell = registry, bag, tell
        self._wanted = None if topics is None else {name for topic in topics for name in _names(topic)}
        self._sources: dict[str, _Source] = {}
        self._done: dict[str, tuple[int, int, int]] = {}
        """Samples, missed and damaged ones of regions that are gone, by topic."""
        self._refused: dict[str, int | None] = {}
        """Inodes of regions that cannot be recorded, by name."""
        self._channels: dict[tuple[str, str, int], int] = {}
        self._logged = 0
        self._writer = _Writer(bag)
        self.failed = False
        """Whether there is something that was asked for and could not be recorded."""

    @property
    def figures(self) -> Figures:
        """From any thread."""
        now = {one.topic: (one.samples, one.reader.missed, one.damaged) for one in list(self._sources.values())}
        counts = [*list(self._done.values()), *now.values()]
        samples, missed, damaged = (sum(count[place] for count in counts) for place in range(3))
        return Figures(len(now.keys() | self._done.keys()), samples, missed, damaged, self._bag.size)

    def run(self, stopping: threading.Event, seconds: float | None = None) -> None:
        """Until `stopping` is set or so many seconds are over. Raises OSError; the bag is readable all the same."""
        ends = None if seconds is None else time.monotonic() + seconds
        chunk, searched, changed, flushed, first = Chunk(), 0.0, 0, time.monotonic(), True
        with self._writer, _undisturbed():
            try:
                while not stopping.is_set() and (ends is None or time.monotonic() < ends):
                    now = time.monotonic()
                    since = now - searched
                    if since >= _SEARCH or (since >= _AT_ONCE and os.stat(regions.FOLDER).st_mtime_ns != changed):
                        changed = os.stat(regions.FOLDER).st_mtime_ns
                        self._search(first)
                        searched, first = now, False
                    if self._writer.waiting < _WAITING:
                        self._take(chunk)
                    if chunk.size >= _CHUNK or (chunk.messages and now - flushed >= _FLUSH):
                        self._writer.put(chunk)
                        chunk, flushed = Chunk(), now
                    self._writer.check()
                    time.sleep(_LOOK)
                self._take(chunk)
            finally:
                for name in list(self._sources):
                    self._drop(name)
                if chunk.messages:
                    self._writer.put(chunk)
                self._writer.finish(self._notes())

    def _take(self, chunk: Chunk) -> None:
        self._logged = logged = max(self._logged, time.time_ns())
        for source in self._sources.values():
            for number, stamp, message in source.reader.samples():
                try:
                    data = source.kind.encode(bytes(message))
                except (ValueRejected, struct.error) as error:
                    if not source.damaged:
                        self._tell(f"{source.topic}: damaged sample {number}: {error}")
                    source.damaged += 1
                    continue
                chunk.add(source.channel, number, logged, stamp or logged, data)
                source.samples += 1

    def _search(self, first: bool) -> None:
        for name, source in list(self._sources.items()):
            if source.view.removed:
                self._drop(name)
        there = set(regions.live() if self._wanted is None else self._wanted)
        for name in sorted(there - self._sources.keys()):
            try:
                self._open(name, first)
            except RegionMissing:
                self._refused.pop(name, None)
            except (ShmError, Rejected, ValueError, OSError) as error:
                self._refuse(name, error)

    def _open(self, name: str, first: bool) -> None:
        """The region, from its newest sample on, or if it was made meanwhile from its first."""
        if _inode(name) == self._refused.get(name, 0):
            return
        view = View(name)
        try:
            if view.header().magic != h.MAGIC:
                view.close()
                return
            header = sound(view)
            kind = kind_of(self._registry, header.type_name, header.digest)
            kind.encode  # noqa: B018 made now, while nothing waits for it
            reader = watcher(view, kind.message, history=not first)
        except BaseException:
            view.close()
            raise
        topic = topic_of(name)
        self._sources[name] = _Source(topic, view, reader, kind, self._channel(topic, kind, depth_of(header)))

    def _refuse(self, name: str, error: Exception) -> None:
        self._refused[name] = _inode(name)
        self._tell(f"{topic_of(name)}: not recorded: {error}")
        self.failed = True

    def _channel(self, topic: str, kind: Kind, depth: int) -> int:
        key = topic, kind.name, kind.layout.digest
        if key not in self._channels:
            self._channels[key] = number = len(self._channels) + 1
            ours = {
                "shmgen_topic": topic,
                "shmgen_depth": str(depth),
                "shmgen_digest": f"{kind.layout.digest:016x}",
                "shmgen_layout": kind.lock,
            }
            self._writer.put(Channel(number, bag_topic(topic), kind.name, kind.text, kind.type_hash, ours))
        return self._channels[key]

    def _drop(self, name: str) -> None:
        """What came and is not taken any more was missed."""
        source = self._sources.pop(name)
        samples, missed, damaged = self._done.get(source.topic, (0, 0, 0))
        missed += source.reader.missed + source.reader.unread
        self._done[source.topic] = samples + source.samples, missed, damaged + source.damaged
        source.reader.close()
        source.view.close()

    def _notes(self) -> dict[str, str]:
        """Missed and damaged samples by topic, for the bag."""
        missed = {topic: missed for topic, (_, missed, _) in self._done.items()}
        damaged = {topic: damaged for topic, (_, _, damaged) in self._done.items() if damaged}
        return {"missed": json.dumps(missed), "damaged": json.dumps(damaged)}


def bag_topic(topic: str) -> str:
    """A name that ROS allows: `/cell/start-request` is `/cell/start/_request`, which `ros2 topic list` hides."""
    full, dash, half = topic.partition("-")
    return f"{full}/_{half}" if dash else topic


def _names(topic: str) -> list[str]:
    """The region of a topic, and what would be the halves of a service or action of that name."""
    halves = [] if "-" in topic else [f"{topic}-{half}" for half in HALVES]
    return [region_name(one) for one in (topic, *halves)]


def _inode(name: str) -> int | None:
    """Of the region's file; to know it nobody needs to be allowed to read it."""
    with suppress(OSError):
        return os.lstat(region_file(name)).st_ino
    return None


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Other threads give way sooner; and nothing made here is part of a ring, for which to look takes milliseconds."""
    collects, interval = gc.isenabled(), sys.getswitchinterval()
    gc.disable()
    sys.setswitchinterval(_LOOK)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        if collects:
            gc.enable()


class _Writer:
    """The thread that writes: the disk may stand still for seconds, and nobody waits for it."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._queue: queue.SimpleQueue[Chunk | Channel | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._error: BaseException | None = None
        self._put = self._written = 0
        self._notes: dict[str, str] = {}

    @property
    def waiting(self) -> int:
        """Bytes."""
        return self._put - self._written

    def put(self, item: Chunk | Channel) -> None:
        if isinstance(item, Chunk):
            self._put += item.size
        self._queue.put(item)

    def check(self) -> None:
        """Raises what the thread met with, an OSError."""
        if self._error:
            raise self._error

    def finish(self, notes: dict[str, str]) -> None:
        """Waits until all is written. Raises as check()."""
        self._notes = notes
        self._queue.put(None)
        self._thread.join()
        self.check()

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._bag.abandon()

    def _run(self) -> None:
        said = time.monotonic()
        try:
            while (item := self._queue.get()) is not None:
                if isinstance(item, Channel):
                    self._bag.add(item)
                    continue
                self._bag.put(item)
                self._written += item.size
                if time.monotonic() - said >= _FLUSH:
                    self._bag.say()
                    said = time.monotonic()
            self._bag.end_file(self._notes)
            self._bag.say(self._notes)
        except BaseException as error:
            self._error = error
