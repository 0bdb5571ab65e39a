"""Turns `close()` into what `with` does at its end, for all that holds regions open."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import TypeVar

C = TypeVar("C", bound="Closing")


class Closing(ABC):
    """Base of publishers, subscribers, clients and servers."""

    @abstractmethod
    def close(self) -> None:
        """Lets go of the regions, which stay as they are."""

    def __enter__(self: C) -> C:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
