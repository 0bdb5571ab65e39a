"""Records the samples of live regions in order, with the sequence number and stamp of their writer."""

from __future__ import annotations

import gc
import json
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from shmgen.bag.folder import Bag
from shmgen.bag.kinds import Kind
from shmgen.bag.mcap import Channel, Chunk
from shmgen.core.diagnostics import Rejected
from shmgen.live import regions
from shmgen.live.classes import ClassRegistry, watcher
from shmgen.live.regions import View, depth_of, sound, topic_of
from shmgen.runtime import Message, ShmError, Subscriber, region_name
from shmgen.runtime.errors import RegionMissing, ValueRejected
from shmgen.runtime.region import header as h
from shmgen.runtime.region.names import HALVES, region_file

_LOOK = 5e-4
"""Seconds between two polls of all regions. A region with two slots, written at 1 kHz, keeps each sample for 1 ms."""
_SEARCH = 0.25
"""Seconds between two searches for created and removed regions."""
_AT_ONCE = 5e-3
"""Seconds between two searches while files in /dev/shm are created or removed."""
_CHUNK = 1 << 20
"""Size in bytes at which a chunk of messages is written to the file."""
_FLUSH = 0.5
"""Seconds after which a smaller chunk is written too. SIGKILL loses at most this much."""
_WAITING = 64 << 20
"""Bytes that may wait for the disk. Beyond this, no samples are read, and overwritten samples count as missed."""

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Figures:
    """Totals of a recording: `size` in bytes, and the numbers of topics and of recorded, missed and damaged samples."""

    topics: int
    samples: int
    missed: int
    damaged: int
    size: int


@dataclass(slots=True)
class _Source:
    """A region that is being recorded, with its reader and the counts of its samples."""

    topic: str
    view: View
    reader: Subscriber[Message]
    kind: Kind
    channel: Channel
    samples: int = 0
    damaged: int = 0


class Recorder:
    """Records live regions into a bag. The caller's thread reads the regions, and a second thread writes the bag."""

    def __init__(self, registry: ClassRegistry, bag: Bag, topics: Collection[str] | None, tell: Tell) -> None:
        """Prepare to record `topics` into `bag`. For a service or an action, record all its regions.

        If `topics` is None, record all regions, including regions created later. `tell` receives lines for the user.
        """
        self._registry, self._bag, self._tell = registry, bag, tell
        self._wanted = None if topics is None else {name for topic in topics for name in _names(topic)}
        self._sources: dict[str, _Source] = {}
        self._done: dict[str, tuple[int, int, int]] = {}
        """Counts of recorded, missed and damaged samples of removed regions, by topic."""
        self._refused: dict[str, int | None] = {}
        """Inodes of regions that cannot be recorded, by region name."""
        self._channels: dict[tuple[str, str, int], Channel] = {}
        self._logged = 0
        self._writer = _Writer(bag)
        self.failed = False
        """True if a requested region could not be recorded."""

    @property
    def figures(self) -> Figures:
        """The totals so far. Thread-safe."""
        now = {one.topic: (one.samples, one.reader.missed, one.damaged) for one in list(self._sources.values())}
        counts = [*list(self._done.values()), *now.values()]
        samples, missed, damaged = (sum(count[place] for count in counts) for place in range(3))
        return Figures(len(now.keys() | self._done.keys()), samples, missed, damaged, self._bag.size)

    def never_seen(self, topics: Iterable[str]) -> list[str]:
        """Return the names in `topics` (topics, services, actions) that had no region during the whole recording."""
        seen = {region_name(topic) for topic in (*self._done, *(one.topic for one in self._sources.values()))}
        return [
            topic for topic in topics if seen.isdisjoint(_names(topic)) and not self._refused.keys() & _names(topic)
        ]

    def run(self, stopping: threading.Event, seconds: float | None = None) -> None:
        """Record until `stopping` is set or `seconds` are over.

        Raises OSError if the bag cannot be written; the bag is readable despite that.
        """
        ends = None if seconds is None else time.monotonic() + seconds
        chunk, searched, changed, flushed, first = Chunk(), 0.0, 0, time.monotonic(), True
        with self._writer, _avoid_pauses():
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
                except ValueRejected as error:
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
        """Start to record a region. Do nothing for a refused region, or if the header is not complete.

        If `first` is True, the region existed before the recording: begin with the newest sample. Otherwise, begin with
        the oldest sample.
        """
        if _inode(name) == self._refused.get(name, 0):
            return
        view = View(name)
        try:
            if view.header().magic != h.MAGIC:
                view.close()
                return
            header = sound(view)
            kind = Kind(self._registry.session_of(header.type_name, header.digest), header.type_name)
            kind.encode  # noqa: B018 build the encoder now, before samples wait for it
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

    def _channel(self, topic: str, kind: Kind, depth: int) -> Channel:
        key = topic, kind.name, kind.layout.digest
        if key not in self._channels:
            metadata = {
                "offered_qos_profiles": "[]",
                "topic_type_hash": kind.type_hash,
                "shmgen_topic": topic,
                "shmgen_depth": str(depth),
                "shmgen_digest": f"{kind.layout.digest:016x}",
                "shmgen_layout": kind.lock,
            }
            self._channels[key] = Channel(bag_topic(topic), kind.name, kind.text, metadata)
            self._writer.put(self._channels[key])
        return self._channels[key]

    def _drop(self, name: str) -> None:
        """Stop recording a region. Its unread samples count as missed."""
        source = self._sources.pop(name)
        samples, missed, damaged = self._done.get(source.topic, (0, 0, 0))
        missed += source.reader.missed + source.reader.unread
        self._done[source.topic] = samples + source.samples, missed, damaged + source.damaged
        source.reader.close()
        source.view.close()

    def _notes(self) -> dict[str, str]:
        """Return how many samples of each topic were missed or damaged, as two JSON texts for the bag's metadata."""
        missed = {topic: missed for topic, (_, missed, _) in self._done.items()}
        damaged = {topic: damaged for topic, (_, _, damaged) in self._done.items() if damaged}
        return {"missed": json.dumps(missed), "damaged": json.dumps(damaged)}


def bag_topic(topic: str) -> str:
    """Return a topic name that ROS allows: `/cell/start-request` -> `/cell/start/_request`.

    `ros2 topic list` hides topics with a leading `_` in a part of the name.
    """
    full, dash, half = topic.partition("-")
    return f"{full}/_{half}" if dash else topic


def _names(topic: str) -> list[str]:
    """Return the names of all regions that `topic` may stand for: a topic, or the parts of a service or an action."""
    halves = [] if "-" in topic else [f"{topic}-{half}" for half in HALVES]
    return [region_name(one) for one in (topic, *halves)]


def _inode(name: str) -> int | None:
    """Return the inode of a region's file, or None if the file does not exist. Needs no read permission."""
    with suppress(OSError):
        return os.lstat(region_file(name)).st_ino
    return None


@contextmanager
def _avoid_pauses() -> Iterator[None]:
    """Shorten the thread switch interval and turn off garbage collection, which would pause for milliseconds.

    The recorder creates no reference cycles, so reference counting frees its objects.
    """
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
    """The thread that writes the bag. The disk may stall for seconds, and the recorder must not wait for the disk."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._queue: queue.SimpleQueue[Chunk | Channel | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._error: BaseException | None = None
        self._put = self._written = 0
        self._notes: dict[str, str] = {}

    @property
    def waiting(self) -> int:
        """The number of bytes that are queued and not yet written."""
        return self._put - self._written

    def put(self, item: Chunk | Channel) -> None:
        if isinstance(item, Chunk):
            self._put += item.size
        self._queue.put(item)

    def check(self) -> None:
        """Raise the error that stopped the thread, usually an OSError. Do nothing if there was no error."""
        if self._error:
            raise self._error

    def finish(self, notes: dict[str, str]) -> None:
        """Wait until everything is written, then store `notes` in the bag. Raises the errors of check()."""
        self._notes = notes
        self._queue.put(None)
        self._thread.join()
        self.check()

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._bag.abandon()

    def _run(self) -> None:
        last_saved_at = time.monotonic()
        try:
            while (item := self._queue.get()) is not None:
                if isinstance(item, Channel):
                    self._bag.add(item)
                    continue
                self._bag.put(item)
                self._written += item.size
                if time.monotonic() - last_saved_at >= _FLUSH:
                    self._bag.write_metadata()
                    last_saved_at = time.monotonic()
            self._bag.end_file(self._notes)
            self._bag.write_metadata(self._notes)
        except BaseException as error:
            self._error = error
