"""Encode any object with the attributes of a message into bytes, and decode bytes into attributes.

The extension in C (table.c, objects.c) does the same for usual values. For each unusual value, the extension calls a
function in TOOLS, so that all error messages are in this package.
"""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any

from shmgen.runtime.errors import OutOfRange, ValueRejected
from shmgen.runtime.messages.numbers import (
    REFUSED,
    check,
    check_count,
    decode_numbers,
    elements,
    encode_item,
    encode_number,
    encode_numbers,
)
from shmgen.runtime.messages.steps import COUNT, STRUCTS, Step
from shmgen.runtime.messages.strings import TEXTS, decode_text, encode_text
from shmgen.runtime.messages.times import CLOCKS, Duration, Time, decode_clock, encode_clock, set_clock

_PACK = {kind: packed.pack_into for kind, packed in STRUCTS.items() if kind != "bool"}
_UNPACK = {kind: packed.unpack_from for kind, packed in STRUCTS.items()}


def encode(kind: Any, message: Any, into: bytearray | memoryview, at: int = 0) -> int:
    """Write `message` into the zeroed bytes `into`, starting at byte `at`, in the layout of the class `kind`.

    Return the number of truncated strings. Raises ValueRejected if a value does not fit.
    """
    truncated = 0
    for step in kind._steps_:
        name, type_, offset, size, length, count_at = step
        try:
            value = getattr(message, name)
        except AttributeError as error:
            raise missing(message, name, error) from None
        if length:
            count, cuts = encode_array(step, value, into, at + offset)
            truncated += cuts
            if count_at >= 0:
                COUNT.pack_into(into, at + count_at, count)
        elif pack := _PACK.get(type_):
            try:
                pack(into, at + offset, value)
            except REFUSED:
                check(type_, value, step.path)
                raise
        elif isinstance(type_, str):
            truncated += encode_element(type_, value, into, at + offset, size, step.path)
        else:
            try:
                truncated += encode(type_, value, into, at + offset)
            except ValueRejected as error:
                raise error.inside(step.path) from None
    return truncated


def encode_element(kind: Any, value: Any, into: Any, at: int, size: int, path: str) -> int:
    """Write a single value of `size` bytes to `into` at byte `at`. Return the number of truncated strings.

    Raises ValueRejected if the value does not fit.
    """
    if kind in STRUCTS:
        encode_number(kind, value, into, at, path)
    elif kind in TEXTS:
        data, truncated = encode_text(kind, value, size, path)
        into[at : at + len(data)] = data
        return truncated
    elif kind in CLOCKS:
        into[at : at + size] = encode_clock(kind, value, path)
    else:
        try:
            return encode(kind, value, into, at)
        except ValueRejected as error:
            raise error.inside(path) from None
    return 0


def encode_array(step: Step, value: Any, into: Any, at: int) -> tuple[int, int]:
    """Write the elements of an array into `into`, starting at byte `at`.

    Return the number of elements and the number of truncated strings.
    """
    if step.kind in STRUCTS:
        data = number_array(step, value)
        memoryview(into)[at : at + data.nbytes] = data  # without an intermediate copy
        return data.nbytes // step.size, 0
    items, truncated = sequence(step, value), 0
    for position, item in enumerate(items):
        truncated += encode_element(step.kind, item, into, at, step.size, f"{step.path}[{position}]")
        at += step.size
    return len(items), truncated


def number_array(step: Step, value: Any) -> memoryview:
    """Return the numbers of the array `value` as bytes. Raises CountExceeded and OutOfRange."""
    return encode_numbers(step.kind, value, step.length, step.count_at < 0, step.path)


def sequence(step: Step, value: Any) -> list[Any]:
    """Return the strings, times or messages of the array `value` as a list. Raises CountExceeded and OutOfRange."""
    if step.kind in TEXTS and isinstance(value, (str, bytes)):
        raise OutOfRange(step.path, f"expected a sequence of strings, not {type(value).__name__}")
    return elements(value, step.length, step.count_at < 0, step.path)


def decode(kind: Any, data: bytes | bytearray | memoryview, message: Any, at: int = 0) -> None:
    """Set the attributes of `message` from `data`, the bytes of a message of class `kind`, starting at byte `at`.

    Raises CountExceeded if a count is above its bound.
    """
    for step in kind._steps_:
        name, type_, offset, _, length, _ = step
        if length:
            value = decode_array(step, data, at, () if type_ in TEXTS else getattr(message, name))
        elif unpack := _UNPACK.get(type_):
            value = unpack(data, at + offset)[0]
        elif isinstance(type_, str):
            value = decode_element(step, data, at + offset, getattr(message, name) if type_ in CLOCKS else None)
        else:
            try:
                decode(type_, data, getattr(message, name), at + offset)
            except ValueRejected as error:
                raise error.inside(step.path) from None
            continue
        setattr(message, name, value)


def decode_element(step: Step, data: Any, at: int, like: Any = None) -> Any:
    """Return the value of a field, or of one element of an array, at byte `at`.

    If `like` is a message or a time, set its attributes and return `like`. If `like` is None, return a new object of
    shmgen's own class.
    """
    kind, part = step.kind, data[at : at + step.size]
    if kind in TEXTS:
        return decode_text(kind, part)
    if kind in CLOCKS:
        clock = decode_clock(kind, part)
        return clock if like is None else set_clock(like, clock)
    if like is None:
        return kind.from_buffer_copy(part)
    decode(kind, data, like, at)
    return like


def decode_array(step: Step, data: Any, at: int, like: Any) -> Any:
    """Return the elements of an array. The result and its elements have the same types as `like`.

    Messages and times are always new objects, because the caller may have put one object into `like` twice.
    """
    count, start = decode_count(step, data, at), at + step.offset
    if step.kind in STRUCTS:
        return decode_numbers(data[start : start + count * step.size], step.kind, like)
    return decode_elements(step, data, start, count, like)


def decode_count(step: Step, data: Any, at: int) -> int:
    """Return the number of elements of an array. Raises CountExceeded if the count is above its bound."""
    if step.count_at < 0:
        return step.length
    count: int = COUNT.unpack_from(data, at + step.count_at)[0]
    check_count(count, step.length, step.path)
    return count


def decode_elements(step: Step, data: Any, start: int, count: int, like: Any) -> list[Any]:
    """Return `count` strings, times or messages from byte `start` on, of the same class as the elements of `like`."""
    model, items = _model(step.kind, like), []
    for position in range(count):
        new = None if model is None else copy.copy(model) if step.kind in CLOCKS else new_like(model)
        items.append(inside(f"{step.path}[{position}]", decode_element, step, data, start + position * step.size, new))
    return items


def _model(kind: Any, like: Any) -> Any:
    """Return an element of `like` whose class the decoded elements must get, or None for shmgen's own classes.

    A caller may use classes of another library, such as ROS, for messages and times. Strings always give None.
    """
    if kind in TEXTS or not len(like):
        return None
    is_ours = isinstance(like[0], (Time, Duration)) if kind in CLOCKS else type(like[0]) is kind
    return None if is_ours else like[0]


def inside(path: str, call: Any, *arguments: Any) -> Any:
    """Call `call` with the arguments. If `call` raises ValueRejected, prepend `path` to the path in the error."""
    try:
        return call(*arguments)
    except ValueRejected as error:
        raise error.inside(path) from None


def new_like(message: Any) -> Any:
    """Return a new object of the type of `message`."""
    try:
        return type(message)()
    except TypeError:  # a dataclass without defaults, as in rosbags
        return copy.deepcopy(message)


def missing(message: Any, name: str, error: AttributeError) -> OutOfRange:
    """Return the error for a message whose attribute `name` is missing or raises `error`."""
    path = name.removesuffix("_")
    if getattr(error, "obj", message) is message and getattr(error, "name", name) == name:
        advice = "; create a message first: TYPE(**values)" if isinstance(message, dict) else ""
        return OutOfRange(path, f"{type(message).__name__} has no attribute {path!r}{advice}")
    return OutOfRange(path, f"cannot encode {type(message).__name__}: {error}")


# --- called by the extension -------------------------------------------------------------------------


def element(step: Step, value: Any, index: int) -> bytes:
    """Return the bytes of one value. `index` is its position in an array, or -1 if the field is not an array.

    Raises ValueRejected if the value does not fit.
    """
    into = bytearray(step.size)
    if step.kind in STRUCTS and index >= 0:
        encode_item(step.kind, value, into, 0, place(step, index))
    else:
        encode_element(step.kind, value, into, 0, step.size, place(step, index))
    return bytes(into)


def place(step: Step, index: int) -> str:
    """Return the path of a field for error messages, or of its element `index` if `index` is not negative."""
    return step.path if index < 0 else f"{step.path}[{index}]"


def raise_missing(message: Any, name: str, error: AttributeError) -> None:
    raise missing(message, name, error) from None


def raise_nested(step: Step, index: int, error: ValueRejected) -> None:
    raise error.inside(place(step, index)) from None


def raise_count(step: Step, count: int) -> None:
    check_count(count, step.length, step.path)


def refuse(step: Step, index: int, reason: str) -> None:
    raise OutOfRange(place(step, index), reason)


TOOLS = (
    *("sec", "nanosec", "secs", "nsecs", "__copy__", "from_buffer_copy"),
    *(Time, Duration, SimpleNamespace, ValueRejected, copy.copy, new_like, decode_numbers),
    *(number_array, sequence, element, raise_missing, raise_nested, raise_count, refuse),
)
"""The names, types and functions that the extension uses, in the order of table.h."""
