"""A message that lies in a sample and can be read there, and not written."""

from __future__ import annotations

import ctypes
import mmap
from typing import Any

from shmgen.runtime.messages.plan import NUMBERS


class InPlace:
    """The fields of a message in a region: arrays of numbers are read-only memoryviews, all else as in a message.

    A writer may change them at any time. Raises CountExceeded for a count that is being written.
    """

    __slots__ = ("_at", "_map", "_message")

    def __init__(self, message: ctypes.Structure, map: mmap.mmap, at: int) -> None:
        """`message` lies in `map`, from byte `at` on."""
        self._message, self._map, self._at = message, map, at

    def __getattr__(self, name: str) -> Any:
        return self._shown(getattr(self._message, name))

    def __repr__(self) -> str:
        return f"{self._message!r} in place"

    def _shown(self, value: Any) -> Any:
        if not isinstance(value, (ctypes.Structure, ctypes.Array)):
            return value
        at = self._at + ctypes.addressof(value) - ctypes.addressof(self._message)
        if isinstance(value, ctypes.Structure):
            return InPlace(value, self._map, at)
        if issubclass(value._type_, ctypes.Structure):
            return tuple(map(self._shown, value))
        code: Any = NUMBERS[value._type_]
        return memoryview(self._map)[at : at + ctypes.sizeof(value)].cast(code).toreadonly()
