"""A read-only view of a message in a region, without a copy."""

from __future__ import annotations

import ctypes
import mmap
from typing import Any

from shmgen.runtime.messages.fields import KINDS
from shmgen.runtime.messages.steps import CODES


class InPlace:
    """A read-only view of a message in a region.

    Arrays of numbers are read-only memoryviews; all other fields are as in a message. A writer may change the data at
    any time. Reading a sequence raises CountExceeded if the writer has just stored a count above the bound.
    """

    __slots__ = ("_at", "_map", "_message")

    def __init__(self, message: ctypes.Structure, map: mmap.mmap, at: int) -> None:
        """Create a view of `message`, which starts at byte `at` of `map`."""
        self._message, self._map, self._at = message, map, at

    def __getattr__(self, name: str) -> Any:
        return self._in_place(getattr(self._message, name))

    def __repr__(self) -> str:
        return f"{self._message!r} in place"

    def _in_place(self, value: Any) -> Any:
        if not isinstance(value, (ctypes.Structure, ctypes.Array)):
            return value
        at = self._at + ctypes.addressof(value) - ctypes.addressof(self._message)
        if isinstance(value, ctypes.Structure):
            return InPlace(value, self._map, at)
        if issubclass(value._type_, ctypes.Structure):
            return tuple(map(self._in_place, value))
        code: Any = CODES[KINDS[value._type_]]
        return memoryview(self._map)[at : at + ctypes.sizeof(value)].cast(code).toreadonly()
