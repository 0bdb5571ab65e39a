"""Descriptors that show a member of a shared structure as ROS shows it: text as str, a sequence with its length.

A generated class declares them beside its `_fields_`; plain numbers and nested messages need none.
Offsets and sizes are in bytes from the start of the structure. Setting a value checks it as `publish` does
(StringTooLong, OutOfRange, CountExceeded with the field's name), so a structure never holds what no peer can read.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable
from typing import Any

from shmgen.runtime.messages import values
from shmgen.runtime.messages.range_checks import array_of

Encode = Callable[[Any, int, str], bytes]
"""value, capacity, path -> bytes without padding, such as values.text."""


class Text:
    """STRING(capacity) or WSTRING(capacity) in `size` bytes, as str."""

    def __init__(
        self, offset: int, size: int, capacity: int, encode: Encode, decode: Callable[[bytes | bytearray], str]
    ) -> None:
        self.offset, self.size, self.capacity = offset, size, capacity
        self.encode, self.decode = encode, decode

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, structure: ctypes.Structure, owner: type) -> str:
        return self.decode(_load(structure, self.offset, self.size))

    def __set__(self, structure: ctypes.Structure, value: str) -> None:
        _store(structure, self.offset, self.encode(value, self.capacity, self.name).ljust(self.size, b"\0"))


class Clock:
    """A time or duration packed as `code`, as an object with `sec` and `nanosec`."""

    def __init__(self, offset: int, code: str, convert: Callable[[Any, str], Any], make: Callable[..., Any]) -> None:
        self.array = Clocks(offset, code, 1, convert, make)

    def __set_name__(self, owner: type, name: str) -> None:
        self.array.name = name

    def __get__(self, structure: ctypes.Structure, owner: type) -> Any:
        return self.array.__get__(structure, owner)[0]

    def __set__(self, structure: ctypes.Structure, value: Any) -> None:
        self.array.__set__(structure, [value])


class Elements:
    """An array of numbers or messages, shown in place: what is changed in it is changed in the structure.

    `length` elements of `kind`; with `count_at`, the offset of the UDINT that says how many of them are valid.
    """

    def __init__(self, offset: int, kind: Any, length: int, count_at: int | None = None) -> None:
        self.offset, self.kind, self.length, self.count_at = offset, kind, length, count_at
        self.size = ctypes.sizeof(kind)

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, structure: ctypes.Structure, owner: type) -> Any:
        count = _count(structure, self.count_at, self.length, self.name)
        return array_of(self.kind, count, self.name).from_buffer(structure, self.offset)

    def __set__(self, structure: ctypes.Structure, value: Any) -> None:
        rule = _rule(self.count_at, self.length)
        if issubclass(self.kind, ctypes.Structure):
            data = bytearray(self.size * len(value))
            late: list[tuple[int, int, memoryview]] = []
            values.each(value, self.kind._encode, data, 0, self.size, self.name, late, **rule)
            for offset, _, view in late:
                data[offset : offset + len(view)] = view
            stored = memoryview(data)
        else:
            stored = values.numbers(value, self.kind._type_, self.size, self.name, **rule)
        _store(structure, self.offset, stored)
        _set_count(structure, self.count_at, len(stored) // self.size)


class Texts:
    """An array of STRING(capacity) or WSTRING(capacity), each in `item_size` bytes, as a list of str."""

    def __init__(
        self,
        offset: int,
        item_size: int,
        capacity: int,
        length: int,
        encode: Encode,
        decode: Callable[[bytes | bytearray], str],
        count_at: int | None = None,
    ) -> None:
        self.offset, self.size, self.capacity, self.length = offset, item_size, capacity, length
        self.encode, self.decode, self.count_at = encode, decode, count_at

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, structure: ctypes.Structure, owner: type) -> list[str]:
        count = _count(structure, self.count_at, self.length, self.name)
        return values.from_texts(_load(structure, self.offset, self.size * count), self.decode, self.size)

    def __set__(self, structure: ctypes.Structure, value: Iterable[str]) -> None:
        rule = _rule(self.count_at, self.length)
        data = values.texts(value, self.encode, self.capacity, self.size, self.name, **rule)
        _store(structure, self.offset, data)
        _set_count(structure, self.count_at, len(data) // self.size)


class Clocks:
    """An array of times or durations, each packed as `code`, as a list of objects with `sec` and `nanosec`."""

    def __init__(
        self,
        offset: int,
        code: str,
        length: int,
        convert: Callable[[Any, str], Any],
        make: Callable[..., Any],
        count_at: int | None = None,
    ) -> None:
        self.offset, self.code, self.length, self.count_at = offset, code, length, count_at
        self.convert, self.make = convert, make
        self.item_size = values.clock_size(code)

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, structure: ctypes.Structure, owner: type) -> list[Any]:
        count = _count(structure, self.count_at, self.length, self.name)
        data = _load(structure, self.offset, self.item_size * count)
        return values.from_clocks(data, self.code, self.make)

    def __set__(self, structure: ctypes.Structure, value: Iterable[Any]) -> None:
        data = values.clocks(value, self.code, self.convert, self.name, **_rule(self.count_at, self.length))
        _store(structure, self.offset, data)
        _set_count(structure, self.count_at, len(data) // self.item_size)


def _rule(count_at: int | None, length: int) -> dict[str, int]:
    return {"exactly" if count_at is None else "at_most": length}


def _load(structure: ctypes.Structure, offset: int, size: int) -> bytes:
    return ctypes.string_at(ctypes.addressof(structure) + offset, size)


def _store(structure: ctypes.Structure, offset: int, data: bytes | memoryview) -> None:
    ctypes.memmove(ctypes.addressof(structure) + offset, bytes(data), len(data))


def _count(structure: ctypes.Structure, count_at: int | None, length: int, name: str) -> int:
    if count_at is None:
        return length
    return values.count(ctypes.c_uint32.from_buffer(structure, count_at).value, length, name)


def _set_count(structure: ctypes.Structure, count_at: int | None, count: int) -> None:
    if count_at is not None:
        ctypes.c_uint32.from_buffer(structure, count_at).value = count
