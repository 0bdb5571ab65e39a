"""Ends that are opened by settings, closed at the end of a `with`, and let go in a forked child."""

from __future__ import annotations

import os
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterable
from contextlib import suppress
from types import TracebackType
from typing import Any, Protocol, TypeVar

from shmgen.core import abi

C = TypeVar("C", bound="Closable")
_LOOK = abi.POLL_MS / 1000
"""Seconds between two looks for a peer while a region is opened."""


class Closable(ABC):
    """Base of publishers, subscribers, clients and servers."""

    @abstractmethod
    def close(self) -> None:
        """Closes the regions, which stay as they are."""

    def __enter__(self: C) -> C:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class End(Protocol):
    """What both engines have of an end of a region."""

    def step(self) -> int | None: ...
    def close(self) -> None: ...
    def disown(self) -> None: ...


def kept_from_children(made: Any) -> Any:
    """The same end, file or map; a forked child lets go of it, also of one that its parent is still opening.

    It has the same open file, and with it the parent's claim on the topic, which would outlive the parent.
    """
    _kept.add(made)
    return made


def finish(ends: Iterable[End]) -> None:
    """Opens them all, side by side. Raises what the first raises that cannot be opened."""
    waiting: dict[End, int | None] = dict.fromkeys(ends)
    while waiting:
        moved = False
        for end, before in list(waiting.items()):
            step = end.step()
            moved = moved or step != before
            if step is None:
                del waiting[end]
            else:
                waiting[end] = step
        if not moved:
            time.sleep(_LOOK)


_kept: weakref.WeakSet[Any] = weakref.WeakSet()


def _in_child() -> None:
    for made in list(_kept):
        with suppress(BufferError):  # a map whose words are in use: its region lets go of both
            getattr(made, "disown", made.close)()


os.register_at_fork(after_in_child=_in_child)
