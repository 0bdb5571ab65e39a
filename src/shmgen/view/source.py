"""What the screens show of a region: the newest message, curves of numbers, the bytes of its slots."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layout, Layouts, Role
from shmgen.live.classes import ClassRegistry, publisher, watcher
from shmgen.live.regions import View, damage, depth_of, topic_of
from shmgen.runtime import Message, Sample, region_name
from shmgen.runtime.region import header as h
from shmgen.tools.messages import parse
from shmgen.tools.watch.plot import Curves


class Source:
    """One region, followed when it is made anew. Only looked at; `publish` is the exception."""

    def __init__(self, topic: str, registry: ClassRegistry) -> None:
        """Raises RegionMissing, PermissionDenied, RegionUnusable, Rejected and LayoutMismatch."""
        self.topic = topic
        self._registry = registry
        self._curves = Curves()
        self.curves = self._curves.points
        self._view: View | None = None
        self.newest: Sample[Message] | None = None
        self._open()

    @property
    def kind(self) -> type[Message]:
        return self._reader.message_type

    @property
    def missed(self) -> int:
        """Samples that were overwritten before they could be looked at."""
        return self._reader.missed

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
        taken = self._reader.samples()
        if taken:
            self.newest = taken[-1]
        self._curves.take(taken)
        return bool(taken)

    @property
    def message(self) -> Message | None:
        """The newest."""
        return self.newest.message if self.newest else None

    def toggle(self, path: str) -> bool:
        """Whether the number at `path` is a curve from now on; False also where it is none."""
        if path in self.curves:
            self._curves.drop(path)
            return False
        try:
            self._curves.add(path, self.message or self.kind())
        except ValueError:
            return False
        return True

    def memory(self, start: int, size: int) -> bytes:
        """Bytes of the newest sample, the header of its slot first, as they are in the region now."""
        assert self._view is not None
        header = self._view.header()
        slot = self._view.slot(header.newest, header) or h.HEADER_SIZE
        return self._view.read(slot + start, size)

    def publish(self, text: str) -> str:
        """One sample with the values of `text`, YAML or JSON; says what was published.

        Raises ValueError, ValueRejected, and what a Publisher raises.
        """
        message = parse.build(self.kind, parse.parse(text))
        with publisher(self.kind, self.topic, depth_of(self.header())) as writer:
            writer.publish(message)
            return f"sample {writer.sequence} is in the region"

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
    """(offset, size, path) of what lies in a payload, gaps too, in order; nested messages by their members."""
    from shmgen.show.table import rows

    end = 0
    for row in rows(layout, layouts):
        if row.offset < end or (row.nested and "[" not in row.ros):
            continue
        yield row.offset, row.size, row.path if row.role == Role.DATA.value else f"({row.role})"
        end = row.offset + row.size
