"""Turns `close()`, and a fork, into what is left of all that holds regions open: names, figures, and a typed error."""

from __future__ import annotations

import os
import weakref
from abc import ABC, abstractmethod
from contextlib import suppress
from types import TracebackType
from typing import Any, ClassVar, NoReturn, Protocol, TypeVar

from shmgen.runtime.errors import Closed, InForkedChild, ShmError

C = TypeVar("C", bound="Closable")
F = TypeVar("F", bound="_HasClose")


class _HasClose(Protocol):
    def close(self) -> None: ...


class _Lock(Protocol):
    def forget(self) -> None: ...


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


class RegionHolder(Closable):
    """Base of those that hold a region themselves, and must not hold it in a forked child.

    The child has the same open file, and with it the parent's claim on the topic: it would outlive the parent. So
    the child lets go at once, and whoever uses what it has inherited there is told.
    """

    topic: Any
    _word: ClassVar[str]
    """What errors call it."""
    _lock: _Lock

    def close(self) -> None:
        """Closes the region, which stays as it is."""
        self._let_go(ClosedProxy(Closed, f"{self.topic}: this {self._word} is closed"))

    def _hold(self) -> None:
        """To be called once it is open."""
        _holding.add(self)

    @abstractmethod
    def _let_go(self, gone: ClosedProxy) -> None:
        """Lets go of all, puts `gone` in its place; does nothing the second time."""


class ClosedProxy:
    """Stands where the words of a region were, or a call on them was: every use raises the same error."""

    def __init__(self, kind: type[ShmError], text: str) -> None:
        self._kind, self._text = kind, text

    def __call__(self, *_: object) -> NoReturn:
        raise self._kind(self._text)

    __getitem__ = __setitem__ = __call__


def kept_from_children(made: F) -> F:
    """The same file, map or region; a forked child closes it, also one that its parent is still opening.

    Each keeps the open file, and with it any claim that the parent makes later.
    """
    _kept.add(made)
    return made


_holding: weakref.WeakSet[RegionHolder] = weakref.WeakSet()
_kept: weakref.WeakSet[_HasClose] = weakref.WeakSet()


def _in_child() -> None:
    parent = os.getppid()
    for side in list(_holding):
        text = (
            f"{side.topic}: this {side._word} belongs to process {parent}, from which this one was forked; "
            "open one here, or start processes by the method `spawn`"
        )
        side._lock.forget()
        side._let_go(ClosedProxy(InForkedChild, text))
    for made in list(_kept):
        with suppress(BufferError):  # a map that its region closes; or forked in the middle of a copy
            made.close()


os.register_at_fork(after_in_child=_in_child)
