"""The typed errors of regions and values. Each error reports the place, the reason and the next step."""

from __future__ import annotations

from typing import TypeVar

_Self = TypeVar("_Self", bound="ValueRejected")


class ShmError(Exception):
    """Base class of the errors that the runtime raises.

    ```python
    try:
        PoseSubscriber("/robot/pose")
    except ShmError as error:
        print(error)
    ```
    """


class RegionMissing(ShmError):
    """The region does not exist: no process or PLC has opened the topic yet."""


class RegionUnusable(ShmError):
    """The region cannot be created or mapped: /dev/shm is full, or its file keeps appearing and vanishing."""


class RegionRetired(RegionUnusable):
    """The region was removed, or replaced by a region with another layout. Open the topic again."""


class LayoutMismatch(ShmError):
    """The layout of the region differs from the generated layout. Nothing was read or written."""


class RegionInUse(ShmError):
    """Another writer publishes on the topic."""


class ClaimLost(RegionInUse):
    """Another writer has taken over the topic, because this writer's heartbeat was stale for 1 s or more."""


class Closed(ShmError):
    """The object has been closed."""


class InForkedChild(Closed):
    """The object belongs to the parent process, from which this process was forked. Open a new object here."""


class Reentered(ShmError):
    """A call was made during another call on the same publisher or subscriber, for example by a signal handler.

    The extension in C allows such nested calls, and the engine in Python does not. borrow() also raises Reentered if a
    sample is already borrowed.
    """


class Overwritten(ShmError):
    """The writer has overwritten a borrowed sample. Discard all values that were read from this sample."""


class LockTimeout(ShmError):
    """The lock was not free in time, on a machine where access without the lock is unsafe (not x86)."""


class PermissionDenied(ShmError):
    """The operating system denies access to the region, semaphore or group, or other users could write the region."""


class CallTimeout(ShmError):
    """No response arrived in time. The server may still handle the request; the client discards a late response."""


class NoServer(CallTimeout):
    """No server was available in time; the request was not sent."""


class CallFailed(ShmError):
    """The server reported that the call failed."""


class ValueRejected(ShmError, ValueError):
    """A value does not fit into the message.

    `path` is the field, for example `points[3].x`. `reason` is the error text without the path.

    ```python
    try:
        point = Point(x="far")
    except ValueRejected as error:
        print(error.path, error.reason)
    ```
    """

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(f"{path}: {reason}" if path else reason)
        self.path = path
        self.reason = reason

    def __reduce__(self) -> tuple[type[ValueRejected], tuple[str, str]]:
        return type(self), (self.path, self.reason)

    def inside(self: _Self, prefix: str) -> _Self:
        """Return a copy of this error whose `path` begins with `prefix`, the name of a field of the outer message."""
        joint = "." if self.path and not self.path.startswith("[") else ""
        return type(self)(f"{prefix}{joint}{self.path}", self.reason)


class StringTooLong(ValueRejected):
    """A string is longer than its capacity."""


class OutOfRange(ValueRejected):
    """A value is outside the range of the field's type, or has another type."""


class CountExceeded(ValueRejected):
    """The number of elements exceeds the bound of a sequence, or differs from the length of a fixed array."""
