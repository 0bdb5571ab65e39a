"""A message that was read, with its number and its stamp."""

from __future__ import annotations

from typing import TypeVar

from shmgen.runtime.messages.message import Message

M = TypeVar("M", bound=Message)


class Sample(tuple[int, int, M]):
    """`number, stamp, message`: what Subscriber.samples() gives."""

    __slots__ = ()

    @property
    def number(self) -> int:
        """Its place among all samples of the topic, from 1 on; after 2**32 - 1 comes the number of slots."""
        return self[0]

    @property
    def stamp(self) -> int:
        """Nanoseconds since 1970 when it was written, 0 if its writer has no clock."""
        return self[1]

    @property
    def message(self) -> M:
        return self[2]
