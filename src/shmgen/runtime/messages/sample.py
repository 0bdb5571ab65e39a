"""A message that was read, with its sample number and its time stamp."""

from __future__ import annotations

from typing import TypeVar

from shmgen.runtime.messages.message import Message

M = TypeVar("M", bound=Message)


class Sample(tuple[int, int, M]):
    """A tuple of number, stamp and message, which Subscriber.samples() yields.

    ```python
    with PoseSubscriber("/robot/pose", depth=8) as subscriber:
        subscriber.ready(timeout=1.0)
        for number, stamp, pose in subscriber.samples():
            print(number, stamp, pose.position.x)
    ```
    """

    __slots__ = ()

    @property
    def number(self) -> int:
        """The number of this sample. The first sample of a topic has number 1.

        After 2**32 - 1 the numbers restart at the number of slots.
        """
        return self[0]

    @property
    def stamp(self) -> int:
        """The time of writing in ns since 1970, or 0 if the writer has no clock."""
        return self[1]

    @property
    def message(self) -> M:
        return self[2]
