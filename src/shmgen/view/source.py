"""Reads the data that the screens show: the newest message, curves of numbers, and the bytes of the newest sample."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence

from shmgen.core.model import Layout, Layouts
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


class Source:
    """Reads the region of a topic for the screens, and reopens a recreated region. Only publish() writes.

    `view` gives the header and the bytes of the present region, and `reader` its samples.
    """

    def __init__(self, topic: str, registry: ClassRegistry) -> None:
        """Open the region. Raises RegionMissing, PermissionDenied, RegionUnusable, Rejected and LayoutMismatch."""
        self.topic = topic
        self.curves: dict[str, deque[Point]] = {}
        """The values of each plotted field over time, by the path of the field."""
        self._registry = registry
        self._getters: dict[str, Getter] = {}
        self.newest: Sample[Message] | None = None
        self._open()

    @property
    def kind(self) -> type[Message]:
        return self.reader.message_type

    def look(self) -> bool:
        """Read all new samples. Return False if there are none, or if the header of the region is damaged.

        If the region was removed, open the new region of the topic. Raises the errors of the constructor if this region
        cannot be opened.
        """
        if self.view.removed:
            former_reader, former_view = self.reader, self.view
            self._open()
            former_reader.close()
            former_view.close()
        if damage(self.view.header()):
            return False
        samples = self.reader.samples()
        if samples:
            self.newest = samples[-1]
        self._record(samples)
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
            del self.curves[path], self._getters[path]
            return False
        message = self.message or self.kind()
        try:
            get = getter(type(message), path)
        except ValueError:
            return False
        if number(get(message)) is None and "[" not in path:  # a sequence may get this element later
            return False
        self.curves[path], self._getters[path] = deque(maxlen=_MOST), get
        return True

    def _record(self, samples: Sequence[Sample[Message]]) -> None:
        """Append the values of the plotted fields in `samples` to their curves."""
        now = time.time()
        for sample in samples if self._getters else ():
            message, at = sample.message, sample.stamp / 1e9 or now
            for path, get in self._getters.items():
                value = number(get(message))
                if value is not None:
                    self.curves[path].append((at, value))

    def memory(self, start: int, size: int) -> bytes:
        """Return `size` bytes of the newest sample in the region. `start` counts from the header of the sample's slot.

        A writer may change the bytes at any time.
        """
        header = self.view.header()
        slot = self.view.slot(header.newest, header) or h.HEADER_SIZE
        return self.view.read(slot + start, size)

    def publish(self, text: str) -> str:
        """Publish one sample with the values in `text`, as YAML or JSON. Return a line for the user.

        Raises ValueError if `text` does not parse, ValueRejected if a value does not fit, and the errors of Publisher.
        """
        message = parse.build(self.kind, parse.parse(text))
        with publisher(self.kind, self.topic, depth_of(self.view.header())) as writer:
            writer.publish(message)
            return f"published sample {writer.sequence}"

    def close(self) -> None:
        self.reader.close()
        self.view.close()

    def _open(self) -> None:
        view = View(region_name(self.topic))
        try:
            header = view.header()
            session = self._registry.session_of(header.type_name, header.digest)
            reader = watcher(view, session.message(header.type_name))
        except BaseException:
            view.close()
            raise
        self.view, self.reader = view, reader
        self.layout: Layout = session.layout(header.type_name)
        self.layouts: Layouts = session.layouts([header.type_name])
        self.topic = topic_of(view.name)
        self.newest = None
        self.curves.clear()
        self._getters.clear()
