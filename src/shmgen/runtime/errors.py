"""Turns what can go wrong with a region or a value into typed errors that say where, why and what to do next."""

from __future__ import annotations

from typing import TypeVar

_Self = TypeVar("_Self", bound="ValueRejected")


class ShmError(Exception):
    """Whatever the runtime refuses to do."""


class RegionMissing(ShmError):
    """There is no such region; nobody has opened the topic yet."""


class RegionUnusable(ShmError):
    """The region cannot be made or mapped: no room in /dev/shm, or its file keeps appearing and vanishing."""


class LayoutMismatch(ShmError):
    """The region holds another layout than the one generated here; nothing was read or written."""


class RegionInUse(ShmError):
    """Another writer publishes on the topic."""


class ClaimLost(RegionInUse):
    """Another writer has taken the topic over from this one, which stood still for a second or more."""


class Closed(ShmError):
    """It has been closed."""


class InForkedChild(Closed):
    """It belongs to the process from which this one was forked."""


class LockTimeout(ShmError):
    """The lock was not free in time, on a machine where going on without it is not safe."""


class PermissionDenied(ShmError):
    """The operating system refuses access to region, semaphore or group; or strangers can write what is there."""


class CallTimeout(ShmError):
    """A call was not answered in time. The server may still be at it; nobody hears its answer."""


class NoServer(CallTimeout):
    """Nobody served in time, so the call was not even sent."""


class CallFailed(ShmError):
    """The server has answered that the call failed."""


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
    """A string longer than its capacity."""


class OutOfRange(ValueRejected):
    """A value outside the range of its type, or of another type altogether."""


class CountExceeded(ValueRejected):
    """More elements than the bound allows, or another number than a fixed array has."""
