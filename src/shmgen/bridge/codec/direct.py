"""Finds the short way between the bytes of a topic's region and ROS's, without a message of ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from shmgen.bridge.codec.transcode import Transcoder
from shmgen.bridge.codec.wire_format import WireFormat
from shmgen.core.model import Layout, Layouts
from shmgen.runtime import LATE_FROM, Message, Time


@dataclass(frozen=True, slots=True)
class DirectPath:
    """How a region holds the messages of a wire. `stamp` leads to what becomes ROS's now where it is zero, if any."""

    kind: type[Message]
    layout: Layout
    layouts: Layouts
    stamp: tuple[str, ...] = ()

    def into_region(self, wire_format: WireFormat) -> Callable[[bytes], Message | None]:
        """What makes of ROS's bytes what a publisher takes, or None of what has to go the long way."""
        decode, make = Transcoder(self.layout, self.layouts, wire_format).decode, self.kind.from_buffer

        def message(data: bytes) -> Message | None:
            payload = decode(data)
            return None if payload is None else make(payload)

        return message

    def out_of_region(self, wire_format: WireFormat, now: Callable[[], Time]) -> Callable[[bytes], bytes]:
        """What makes of a payload ROS's bytes; it raises ValueRejected, and struct.error for a time ROS cannot hold."""
        encode = Transcoder(self.layout, self.layouts, wire_format, self.stamp).encode
        return lambda payload: encode(payload, now)


def short_way(kind: type[Message], layout: Layout, layouts: Layouts, stamp: tuple[str, ...]) -> DirectPath | None:
    """None where the long way is no longer, as for pictures."""
    return None if layout.size >= LATE_FROM else DirectPath(kind, layout, layouts, stamp)
