"""Reads the data that the screens show: the newest message, curves of numbers, and the bytes of the newest sample."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence

from shmgen.core.model import Layout, Layouts, Role
from shmgen.live.classes import ClassRegistry, publisher, watcher
from shmgen.live.regions import View, damage, depth_of, topic_of
from shmgen.runtime import Message, Sample, region_name
from shmgen.runtime.region import header as h
from shmgen.tools.messages import parse
from shmgen.tools.messages.paths import Getter, getter
from shmgen.tools.watch.reports import number

_MOST = 20_000
"""Number of values kept for each field; older values are dropped."""

Point = tuple[float, float]
"""Time in seconds since 1970, and value."""


class _Values:
    """Records the values of numeric fields of a topic over time. `points` maps the path of a field to its values."""

    def __init__(self) -> None:
        self.points: dict[str, deque[Point]] = {}
        self._getters: dict[str, Getter] = {}

    def add(self, path: str, message: Message) -> None:
        """Record the field at `path` from now on. Raises ValueError if the field is not a number.

        An element of a sequence is accepted even if `message` has no such element yet.
        """
        get = getter(type(message), path)
        if number(get(message)) is None and "[" not in path:
            raise ValueError(f"{path} is not a number; `shmgen echo --field {path}` prints it")
        self.points[path], self._getters[path] = deque(maxlen=_MOST), get

    def drop(self, path: str) -> None:
        del self.points[path], self._getters[path]

    def clear(self) -> None:
        self.points.clear()
        self._getters.clear()

    def take(self, samples: Sequence[Sample[Message]]) -> None:
        now = time.time()
        for sample in samples if self._getters else ():
            message, at = sample.message, sample.stamp / 1e9 or now
            for path, get in self._getters.items():
                value = number(get(message))
                if value is not None:
                    self.points[path].append((at, value))


class Source:
    """Reads the region of a topic for the screens, and reopens a recreated region. Only publish() writes."""

    def __init__(self, topic: str, registry: ClassRegistry) -> None:
        """Open the region. Raises RegionMissing, PermissionDenied, RegionUnusable, Rejected and LayoutMismatch."""
        self.topic = topic
        self._registry = registry
        self._curves = _Values()
        self.curves = self._curves.points
        self._view: View | None = None
        self.newest: Sample[Message] | None = None
        self._open()

    @property
    def kind(self) -> type[Message]:
        return self._reader.message_type

    @property
    def missed(self) -> int:
        """The number of samples that were overwritten before this reader read them."""
        return self._reader.missed

    def header(self) -> h.Header:
        """Read the current header of the region."""
        assert self._view is not None
        return self._view.header()

    def look(self) -> bool:
        """Read all new samples. Return False if there are none, or if the header of the region is damaged.

        If the region was removed, open the new region of the topic. Raises the errors of the constructor if this region
        cannot be opened.
        """
        assert self._view is not None
        if self._view.removed:
            self.close()
            self._open()
        if damage(self._view.header()):
            return False
        samples = self._reader.samples()
        if samples:
            self.newest = samples[-1]
        self._curves.take(samples)
        return bool(samples)

    @property
    def message(self) -> Message | None:
        """The newest message, or None if there is none."""
        return self.newest.message if self.newest else None

    def toggle(self, path: str) -> bool:
        """Start or stop the curve of the number at `path`.

        Return True if the curve is now drawn. Return False if the curve was removed or the value is not a number.
        """
        if path in self.curves:
            self._curves.drop(path)
            return False
        try:
            self._curves.add(path, self.message or self.kind())
        except ValueError:
            return False
        return True

    def memory(self, start: int, size: int) -> bytes:
        """Return `size` bytes of the newest sample in the region. `start` counts from the header of the sample's slot.

        A writer may change the bytes at any time.
        """
        assert self._view is not None
        header = self._view.header()
        slot = self._view.slot(header.newest, header) or h.HEADER_SIZE
        return self._view.read(slot + start, size)

    def publish(self, text: str) -> str:
        """Publish one sample with the values in `text`, as YAML or JSON. Return a line for the user.

        Raises ValueError if `text` does not parse, ValueRejected if a value does not fit, and the errors of Publisher.
        """
        message = parse.build(self.kind, parse.parse(text))
        with publisher(self.kind, self.topic, depth_of(self.header())) as writer:
            writer.publish(message)
            return f"published sample {writer.sequence}"

    def close(self) -> None:
        if self._view is not None:
            self._reader.close()
            self._view.close()
            self._view = None

    def _open(self) -> None:
        view = View(region_name(self.topic))
        try:
            header = view.header()
            session = self._registry.session_of(header.type_name, header.digest)
            self.layout: Layout = session.layout(header.type_name)
            self.layouts: Layouts = session.layouts([header.type_name])
            self._reader = watcher(view, session.message(header.type_name))
        except BaseException:
            view.close()
            raise
        self._view = view
        self.topic = topic_of(view.name)
        self.newest = None
        self._curves.clear()


def stretches(layout: Layout, layouts: Layouts) -> Iterator[tuple[int, int, str]]:
    """Yield the offset, the size and the path of each field and each gap in a message, in order of the offsets.

    Offsets and sizes are in bytes. For a nested message, yield its fields instead.
    """
    from shmgen.show.table import rows

    end = 0
    for row in rows(layout, layouts):
        if row.offset < end or (row.nested and "[" not in row.ros):
            continue
        yield row.offset, row.size, row.path if row.role == Role.DATA.value else f"({row.role})"
        end = row.offset + row.size
