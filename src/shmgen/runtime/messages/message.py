"""The base class of generated classes: keyword arguments, comparison and readable text."""

from __future__ import annotations

import ctypes
from typing import Any, ClassVar

from shmgen.runtime.errors import CountExceeded
from shmgen.runtime.messages.fields import TabledStructure, short_repr
from shmgen.runtime.messages.walker import decode, encode
from shmgen.runtime.region.access import RegionOptions


class Message(TabledStructure):
    """A message with its layout in shared memory: the base class of generated classes.

    A generated class adds the table of its fields.

    ```python
    pose = Pose(position=Point(x=1.5))
    pose.position.y = 2.5
    print(pose == Pose(position=Point(x=1.5, y=2.5)))
    ```
    """

    __slots__ = ()
    """Empty, so that a misspelt field is an error. Generated classes also have empty slots."""
    _pack_ = 1
    _layout_ = "ms"
    """The layout that `_pack_` implies.

    CPython from 3.14 on warns if `_layout_` is missing, and from 3.19 on raises an error.
    """
    _type_name_: ClassVar[str]
    _digest_: ClassVar[int]
    _regions_: ClassVar[RegionOptions] = RegionOptions()
    _steps_: ClassVar[tuple[Any, ...]] = ()
    _names_: ClassVar[tuple[str, ...]] = ()
    _defaults_: ClassVar[tuple[tuple[str, Any], ...]] = ()
    _initial_: ClassVar[bytes] = b""
    """The bytes of a message with its defaults, or `b""` if all bytes are zero."""

    def __init__(self, *values: Any, **fields: Any) -> None:
        """Create a message from keyword arguments. Fields without an argument get the defaults of the definition.

        Raises ValueRejected if a value is invalid, and TypeError if a name is unknown.
        """
        if values:
            example = f"{self._names_[0]}={values[0]!r:.40}" if self._names_ else ""
            raise TypeError(f"{type(self).__name__} takes its fields by name: {type(self).__name__}({example})")
        if self._initial_:
            ctypes.memmove(ctypes.addressof(self), self._initial_, len(self._initial_))
        for name, value in fields.items():
            if name not in self._names_:
                known = ", ".join(self._names_) or "no fields"
                raise TypeError(f"{type(self).__name__} has no field {name!r}; it has {known}")
            setattr(self, name, value)

    @classmethod
    def _from_object(cls, message: Any) -> Message:
        """Return a message of this class with the values of `message`, an object of any class with the same attributes.

        Raises ValueRejected if a value does not fit.
        """
        data = bytearray(ctypes.sizeof(cls))
        encode(cls, message, data)
        return cls.from_buffer(data)

    @classmethod
    def _decode(cls, data: bytes | bytearray, message: Any) -> None:
        """Set the attributes of `message`, an object of any class, from the bytes `data`.

        Raises CountExceeded if a count is above its bound.
        """
        decode(cls, data, message)

    def _check_counts(self) -> None:
        """Raise CountExceeded if a sequence of this message has a count above its bound. A peer may write any count."""
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
        """Return the constructor and its arguments, for copies and pickles.

        A generated class has no `__dict__`, and the method of ctypes requires a `__dict__`. A subclass that has a
        `__dict__` uses the method of ctypes, which also copies the added attributes.
        """
        return super().__reduce__() if hasattr(self, "__dict__") else (type(self).from_buffer_copy, (bytes(self),))

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={short_repr(getattr(self, name))}" for name in self._names_)
        return f"{type(self).__name__}({fields})"

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_plain(getattr(self, name)) == _plain(getattr(other, name)) for name in self._names_)

    __hash__ = None  # type: ignore[assignment]


def _plain(value: Any) -> Any:
    """Convert arrays of ctypes to lists, because arrays compare by identity and lists by value."""
    return [_plain(item) for item in value] if isinstance(value, ctypes.Array) else value
