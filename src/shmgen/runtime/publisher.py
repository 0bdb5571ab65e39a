"""The publisher of a topic: writes messages into the topic's region. A topic has one writer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from shmgen.runtime import engine
from shmgen.runtime.messages.message import Message
from shmgen.runtime.region.resource import Endpoint, close_after_fork, finish
from shmgen.runtime.region.settings import settings_for

M = TypeVar("M", bound=Message)


class Publisher(Endpoint, Generic[M]):
    """Publish messages of one type on one topic. A forked child must open its own publisher.

    Signal handlers, properties of messages and other threads may call publish() during another publish().
    Each sample stays whole. Without the extension in C, a nested call in the same thread raises Reentered.

    ```python
    with PosePublisher("/robot/pose") as publisher:
        publisher.publish(Pose(position=Point(x=1.5)))
    ```
    """

    message_type: type[M]

    def __init__(
        self,
        topic: str,
        *,
        depth: int = 1,
        lock_timeout: float | None = None,
        mode: int | None = None,
        group: str | int | None = None,
        reopen: bool = True,
    ) -> None:
        """Open or create the region, and claim the topic. The claim takes 1 s if the previous writer was a PLC.

        `depth` is the number of newest samples that slow readers can still read. Publisher and subscriber need the same
        depth. `lock_timeout` is the longest time in seconds that a call waits for the lock, at most 1.
        The default is 0.01 s on x86. Other machines need the lock: by default a call waits until its holder releases
        the lock or is considered dead, 1.1 s at most.
        `mode` (default 0o660) and `group` set the permissions of files that are created here or belong to this user.
        The defaults are the values in shmgen.toml, if any.
        If the region is removed, the next calls reopen the region within 0.1 s, increment `reopen_count`, and log the
        first reopening as `shmgen`. With `reopen=False` the calls raise RegionRetired.
        Raises ValueError (topic, depth, lock_timeout), LayoutMismatch, RegionInUse, PermissionDenied,
        RegionUnusable, LockTimeout.
        """
        end = self._begin(topic, depth=depth, lock_timeout=lock_timeout, mode=mode, group=group, reopen=reopen)
        finish([end])
        self._end = end  # assigned last: a second call of __init__ is refused, and the first endpoint stays usable

    def _begin(self, topic: str, **options: Any) -> Any:
        """Begin to open the region, without waiting, and return the engine's writer. finish() completes the opening."""
        kind = self.message_type
        of = settings_for("publisher", kind, topic, codec=engine.codec(kind), **options)
        self._topic = topic
        return close_after_fork(engine.Writer(of))

    def publish(self, message: Any) -> None:
        """Write `message`: a `message_type`, or any object with the same attributes.

        Raises ValueRejected, with the path of the field, if a value does not fit.
        Raises LockTimeout if this machine needs the lock (not x86) and the lock is not free in time.
        After both errors the region still holds the previous sample.
        Raises ClaimLost if another writer has taken over the topic; this publisher then publishes nothing more.
        Raises LayoutMismatch or RegionInUse if the region was removed and another layout or writer has replaced it.
        The next call then tries to reopen the region.
        """
        self._end.publish(message)

    @contextmanager
    def loan(self) -> Iterator[M]:
        """Yield a new message to fill in. Publish the message when the `with` block ends without an exception."""
        message = self.message_type()
        yield message
        self.publish(message)

    def heartbeat(self) -> None:
        """Show readers that the writer is alive, without publishing a sample.

        Raises ClaimLost if another writer has taken over the topic.
        """
        self._end.heartbeat()

    @property
    def sequence(self) -> int:
        """The number of the newest sample, or 0 before the first.

        After 2**32 - 1 the numbers restart at the number of slots.
        """
        return int(self._end.sequence)

    @property
    def truncations(self) -> int:
        """The number of truncated strings. Always 0 without `overflow = "truncate"` in shmgen.toml."""
        return int(self._end.truncations)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._topic!r}, sequence={self.sequence})"
