"""The publisher of a topic: writes messages into its region, one writer for each topic."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from shmgen.runtime import engine
from shmgen.runtime.messages.message import Message
from shmgen.runtime.region.resource import Closable, finish, kept_from_children
from shmgen.runtime.region.settings import settings_for

M = TypeVar("M", bound=Message)


class Publisher(Closable, Generic[M]):
    """Publishes one type on one topic. Forked children open their own.

    A signal handler, a property of a message and other threads may publish on it meanwhile: each sample is whole.
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
    ) -> None:
        """Opens the region or creates it, and claims it, which takes a second where a PLC was the writer before.

        `depth` is how many samples a slow reader can still fetch, the same on both sides. `lock_timeout`, in
        seconds, is the longest a call waits for the lock; None: 0.01, and where the lock is needed (not on x86) until
        its holder releases it or is considered dead, 1.1 at most. `mode` (0o660) and `group` are for files created
        here, or found and owned by this user; left out they are those of shmgen.toml, if it has any.
        Raises ValueError (topic, depth, lock_timeout), LayoutMismatch, RegionInUse, PermissionDenied,
        RegionUnusable, LockTimeout.
        """
        end = self._begin(topic, depth=depth, lock_timeout=lock_timeout, mode=mode, group=group)
        finish([end])
        self._end = end  # not before: called twice this is refused, and the first goes on

    def _begin(self, topic: str, **options: Any) -> Any:
        """Begins to open it: see open_all()."""
        kind = self.message_type
        of = settings_for("publisher", kind, topic, codec=engine.codec(kind), **options)
        self._topic = topic
        return kept_from_children(engine.Writer(of))

    def publish(self, message: Any) -> None:
        """Writes `message`: a `message_type`, or any object with the same attributes.

        Raises ValueRejected, with the path of the field, for a value that does not fit, and LockTimeout
        where the lock is needed; the region then still holds the former sample. ClaimLost: another writer has taken
        the topic over, and nothing more will be published here.
        """
        self._end.publish(message)

    @contextmanager
    def loan(self) -> Iterator[M]:
        """A fresh message to fill in a `with`, published at its end, or not at all where that ends in an exception."""
        message = self.message_type()
        yield message
        self.publish(message)

    def heartbeat(self) -> None:
        """Shows readers that the writer is alive, without a sample. Raises ClaimLost."""
        self._end.heartbeat()

    def close(self) -> None:
        """Gives the topic up, which others may claim then; the region stays as it is."""
        self._end.close()

    @property
    def topic(self) -> str:
        """As given."""
        return self._topic

    @property
    def sequence(self) -> int:
        """Number of the newest sample, 0 = none yet; after 2**32 - 1 comes the number of slots."""
        return int(self._end.sequence)

    @property
    def lock_misses(self) -> int:
        """How often the lock was not free in time."""
        return int(self._end.lock_misses)

    @property
    def truncations(self) -> int:
        """How many strings publish() has cut; always 0 unless `overflow = "truncate"` in shmgen.toml."""
        return int(self._end.truncations)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._topic!r}, sequence={self.sequence})"
