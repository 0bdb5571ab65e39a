"""The typed errors of regions and values, which say where, why and what to do next."""

from __future__ import annotations

from typing import TypeVar

_Self = TypeVar("_Self", bound="ValueRejected")


class ShmError(Exception):
    """Base class of the errors that the runtime raises."""


class RegionMissing(ShmError):
    """There is no such region; nobody has opened the topic yet."""


class RegionUnusable(ShmError):
    """The region cannot be created or mapped: /dev/shm is full, or its file keeps appearing and vanishing."""


class RegionRetired(RegionUnusable):
    """The region was removed, or replaced by one of another layout; open the topic anew."""


class LayoutMismatch(ShmError):
    """The region holds another layout than the one generated here; nothing was read or written."""


class RegionInUse(ShmError):
    """Another writer publishes on the topic."""


class ClaimLost(RegionInUse):
    """Another writer has taken over the topic: this one's heartbeat was stale for a second or more."""


class Closed(ShmError):
    """The object has been closed."""


class InForkedChild(Closed):
    """The object belongs to the process from which this one was forked."""


class Reentered(ShmError):
    """A call of this end runs already, and was interrupted: without the extension in C no other may come in between."""


class Overwritten(ShmError):
    """The writer has overwritten a sample that was read in place: what was read of it is nothing."""


class LockTimeout(ShmError):
    """The lock was not free in time, on a machine where going on without it is not safe."""


class PermissionDenied(ShmError):
    """The operating system denies access to region, semaphore or group; or other users could write the region."""


class CallTimeout(ShmError):
    """No response came in time. The server may still handle the request; its response is discarded."""


class NoServer(CallTimeout):
    """No server was available in time; the request was not sent."""


class CallFailed(ShmError):
    """The server has reported that the call failed."""


class ValueRejected(ShmError, ValueError):
    """A value that the message cannot carry. `path` is its field, as in `points[3].x`; `reason` the rest."""

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(f"{path}: {reason}" if path else reason)
        self.path = path
        self.reason = reason

    def __reduce__(self) -> tuple[type[ValueRejected], tuple[str, str]]:
        return type(self), (self.path, self.reason)

    def inside(self: _Self, prefix: str) -> _Self:
        """The same error seen from the message that holds this one in its field `prefix`."""
        joint = "." if self.path and not self.path.startswith("[") else ""
        return type(self)(f"{prefix}{joint}{self.path}", self.reason)


class StringTooLong(ValueRejected):
    """A string longer than its bound."""


class OutOfRange(ValueRejected):
    """A value outside the range of its type, or of another type altogether."""


class CountExceeded(ValueRejected):
    """More elements than the bound allows, or another number than a fixed array has."""
