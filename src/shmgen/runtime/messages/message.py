"""The base of generated classes: made of keyword arguments, shown as text one can read."""

from __future__ import annotations

import ctypes
from typing import Any, ClassVar, TypeAlias

from shmgen.runtime.errors import CountExceeded
from shmgen.runtime.messages.range_checks import CheckedStructure
from shmgen.runtime.region.access import RegionOptions

Late: TypeAlias = "list[tuple[int, int, memoryview]]"
"""Arrays that are copied straight into the slot: (offset in scratch, bytes reserved there, the bytes), by offset."""

CUT = (0, 0, memoryview(b""))
"""Among the late arrays: a text was cut."""

LATE_FROM = 4096
"""Bytes of capacity from which an array goes late; below that a copy more costs less than another slice."""

_SHOWN = 32


class Message(CheckedStructure):
    """A message as it is in shared memory: the base of generated classes, which add the fields."""

    __slots__ = ()
    """So that a misspelt field is an error; generated classes have it too."""
    _pack_ = 1
    _layout_ = "ms"
    """What `_pack_` means without it: CPython from 3.14 on warns without it, and from 3.19 on raises an error."""
    _type_name_: ClassVar[str]
    _digest_: ClassVar[int]
    _regions_: ClassVar[RegionOptions] = RegionOptions()
    _names_: ClassVar[tuple[str, ...]] = ()

    def __init__(self, **fields: Any) -> None:
        """Defaults of the definition first, then `fields`. Raises ValueRejected, and TypeError for an unknown name."""
        self._set_defaults()
        for name, value in fields.items():
            if name not in self._names_:
                known = ", ".join(self._names_) or "no fields"
                raise TypeError(f"{type(self).__name__} has no field {name!r}; it has {known}")
            setattr(self, name, value)

    def _set_defaults(self) -> None:
        """Generated where the definition has defaults."""

    @staticmethod
    def _encode(message: Any, into: bytearray | memoryview, at: int, late: Late) -> None:
        """Generated: writes `message` into `into` from byte `at` on, its long arrays into `late`."""
        raise NotImplementedError

    @staticmethod
    def _decode(data: bytes | bytearray, at: int, message: Any) -> None:
        """Generated: fills `message` with the bytes from `at` on."""
        raise NotImplementedError

    def _check_counts(self) -> None:
        """Raises CountExceeded where a peer says that a sequence has more elements than its bound allows."""
        for name in self._names_:
            value = getattr(self, name)
            is_array = isinstance(value, ctypes.Array) and issubclass(value._type_, Message)
            for index, inner in enumerate(value if is_array else [value]):
                try:
                    if isinstance(inner, Message):
                        inner._check_counts()
                except CountExceeded as error:
                    raise error.inside(f"{name}[{index}]" if is_array else name) from None

    def __reduce__(self) -> Any:
        """For copies and pickles: that of ctypes wants a `__dict__`, which only a class of the user's may have."""
        return super().__reduce__() if hasattr(self, "__dict__") else (type(self).from_buffer_copy, (bytes(self),))

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={_shown(getattr(self, name))}" for name in self._names_)
        return f"{type(self).__name__}({fields})"

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_plain(getattr(self, name)) == _plain(getattr(other, name)) for name in self._names_)

    __hash__ = None  # type: ignore[assignment]


def _plain(value: Any) -> Any:
    """Arrays of ctypes compare by identity, lists by value."""
    return [_plain(item) for item in value] if isinstance(value, ctypes.Array) else value


def _shown(value: Any) -> str:
    if not isinstance(value, (ctypes.Array, list, tuple)) or (isinstance(value, tuple) and hasattr(value, "_fields")):
        return repr(value)
    items = [_shown(item) for item in value[:_SHOWN]]
    if len(value) > _SHOWN:
        items.append(f"... {len(value)} in all")
    return f"[{', '.join(items)}]"
