"""Turns the layout of a topic's region into the short way between its bytes and ROS's, without a message of ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from shmgen.bridge.codec.transcode import Transcoder
from shmgen.bridge.codec.wire_format import Dialect
from shmgen.core.model import Layout, Layouts
from shmgen.runtime import LATE_FROM, Message, Time


@dataclass(frozen=True, slots=True)
class ShortWay:
    """How a region holds the messages of a wire. `stamp` leads to what becomes ROS's now where it is zero, if any."""

    kind: type[Message]
    layout: Layout
    layouts: Layouts
    stamp: tuple[str, ...] = ()

    def into_region(self, dialect: Dialect) -> Callable[[bytes], Message | None]:
        """What makes of ROS's bytes what a publisher takes, or None of what has to go the long way."""
        decode, make = Transcoder(self.layout, self.layouts, dialect).decode, self.kind.from_buffer

        def message(data: bytes) -> Message | None:
            payload = decode(data)
            return None if payload is None else make(payload)

        return message

    def out_of_region(self, dialect: Dialect, now: Callable[[], Time]) -> Callable[[bytes], bytes]:
        """What makes of a payload ROS's bytes; it raises ValueRejected, and struct.error for a time ROS cannot hold."""
        encode = Transcoder(self.layout, self.layouts, dialect, self.stamp).encode
        return lambda payload: encode(payload, now)


def short_way(kind: type[Message], layout: Layout, layouts: Layouts, stamp: tuple[str, ...]) -> ShortWay | None:
    """None where the long way is no longer, as for pictures."""
    return None if layout.size >= LATE_FROM else ShortWay(kind, layout, layouts, stamp)
