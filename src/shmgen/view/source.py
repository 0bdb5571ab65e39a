"""Turns a region into what the screens show of it: the newest message, curves of numbers, the bytes of its slots."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator

from shmgen.core.model import Layout, Layouts, Role
from shmgen.live.classes import ClassRegistry, publisher
from shmgen.live.passive_reader import Sample, Tap, tap
from shmgen.live.regions import View, damage, depth_of, topic_of
from shmgen.runtime import Message, region_name
from shmgen.runtime.region import header as h
from shmgen.tools.messages import parse
from shmgen.tools.messages.paths import Getter, getter
from shmgen.tools.watch.plot import Point, number

_MOST = 20_000
"""Points that are kept of a curve."""


class Source:
    """One region, followed when it is made anew. Only looked at; `publish` is the exception."""

    def __init__(self, topic: str, registry: ClassRegistry) -> None:
        """Raises RegionMissing, PermissionDenied, RegionUnusable, Rejected and LayoutMismatch."""
        self.topic = topic
        self._registry = registry
        self.curves: dict[str, deque[Point]] = {}
        self._getters: dict[str, Getter] = {}
        self._view: View | None = None
        self.newest: Sample | None = None
        self.missed = 0
        self._open()

    @property
    def kind(self) -> type[Message]:
        return self._kind

    def header(self) -> h.Header:
        """As it is now."""
        assert self._view is not None
        return self._view.header()

    def look(self) -> bool:
        """Takes what has come; whether that was anything. Raises as the constructor where the region is another one."""
        assert self._view is not None
        if self._view.removed:
            self.close()
            self._open()
        if damage(self._view.header()):
            return False
        taken = self._tap.take()
        if taken:
            self.newest = taken[-1]
        self.missed = self._tap.missed
        if self._getters:
            self._plot(taken)
        return bool(taken)

    @property
    def message(self) -> Message | None:
        """The newest."""
        return self._kind.from_buffer_copy(self.newest.payload) if self.newest else None

    def toggle(self, path: str) -> bool:
        """Whether the number at `path` is a curve from now on; False also where it is none."""
        if path in self.curves:
            del self.curves[path], self._getters[path]
            return False
        get = getter(self._kind, path)
        if self.newest and number(get(self._kind.from_buffer_copy(self.newest.payload))) is None:
            return False
        self.curves[path], self._getters[path] = deque(maxlen=_MOST), get
        return True

    def memory(self, start: int, size: int) -> bytes:
        """Bytes of the newest sample, the header of its slot first, as they are in the region now."""
        assert self._view is not None
        header = self._view.header()
        at = h.HEADER_SIZE + header.completed % header.slots * header.slot_size
        return self._view.read(at + start, size)

    def publish(self, text: str) -> str:
        """One sample with the values of `text`, YAML or JSON; says what was published.

        Raises ValueError, ValueRejected, and what a Publisher raises.
        """
        message = parse.build(self._kind, parse.parse(text))
        with publisher(self._kind, self.topic, depth_of(self.header())) as writer:
            writer.publish(message)
            return f"sample {writer.sequence} is in the region"

    def close(self) -> None:
        if self._view is not None:
            self._tap.close()
            self._view.close()
            self._view = None

    def _open(self) -> None:
        view = View(region_name(self.topic))
        try:
            header = view.header()
            session = self._registry.session_of(header.type_name, header.digest)
            self._kind = session.message(header.type_name)
            self.layout: Layout = session.layout(header.type_name)
            self.layouts: Layouts = session.layouts([header.type_name])
            self._tap: Tap = tap(view, self._kind)
        except BaseException:
            view.close()
            raise
        self._view = view
        self.topic = topic_of(view.name)
        self.newest = None
        self.missed = 0
        self.curves.clear()
        self._getters.clear()

    def _plot(self, taken: list[Sample]) -> None:
        now = time.time()
        for sample in taken:
            message = self._kind.from_buffer_copy(sample.payload)
            at = sample.stamp / 1e9 if sample.stamp else now
            for path, get in self._getters.items():
                value = number(get(message))
                if value is not None:
                    self.curves[path].append((at, value))


def stretches(layout: Layout, layouts: Layouts) -> Iterator[tuple[int, int, str]]:
    """(offset, size, path) of what lies in a payload, gaps too, in order; nested messages by their members."""
    from shmgen.show.table import rows

    end = 0
    for row in rows(layout, layouts):
        if row.offset < end or (row.nested and "[" not in row.ros):
            continue
        yield row.offset, row.size, row.path if row.role == Role.DATA.value else f"({row.role})"
        end = row.offset + row.size
