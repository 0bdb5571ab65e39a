"""Moves strings into the bytes of a STRING or WSTRING, and those bytes back into strings."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from shmgen.runtime.errors import OutOfRange, StringTooLong
from shmgen.runtime.messages.arrays import check_count
from shmgen.runtime.messages.message import CUT, Late


def text(value: str, capacity: int, path: str) -> bytes:
    """UTF-8 without the terminating NUL, at most `capacity` bytes. Raises StringTooLong, OutOfRange."""
    data = _encoded(value, "utf-8", path)
    if len(data) > capacity:
        raise _too_long(path, len(data), capacity, "bytes of UTF-8")
    return data


def text_cut(value: str, capacity: int, path: str, late: Late | None = None) -> bytes:
    """As text(), but cuts what does not fit, before the code point that would be torn, and says so in `late`."""
    data = _encoded(value, "utf-8", path)
    return data if len(data) <= capacity else _cut(data[:capacity].decode(errors="ignore").encode(), late)


def text_latin1(value: str, capacity: int, path: str) -> bytes:
    """Latin-1, at most `capacity` bytes. Raises StringTooLong, and OutOfRange for any other character."""
    data = _encoded(value, "latin-1", path)
    if len(data) > capacity:
        raise _too_long(path, len(data), capacity, "characters")
    return data


def text_latin1_cut(value: str, capacity: int, path: str, late: Late | None = None) -> bytes:
    """As text_latin1(), but cuts what does not fit, and says so in `late`."""
    data = _encoded(value, "latin-1", path)
    return data if len(data) <= capacity else _cut(data[:capacity], late)


def wide_text(value: str, capacity: int, path: str) -> bytes:
    """UTF-16, little-endian, at most `capacity` code units of two bytes. Raises StringTooLong, OutOfRange."""
    data = _encoded(value, "utf-16-le", path)
    if len(data) > 2 * capacity:
        raise _too_long(path, len(data) // 2, capacity, "UTF-16 code units")
    return data


def wide_text_cut(value: str, capacity: int, path: str, late: Late | None = None) -> bytes:
    """As wide_text(), but cuts what does not fit, before a pair that would be torn, and says so in `late`."""
    data = _encoded(value, "utf-16-le", path)
    if len(data) <= 2 * capacity:
        return data
    return _cut(data[: 2 * capacity].decode("utf-16-le", "ignore").encode("utf-16-le"), late)


def from_text(data: bytes | bytearray) -> str:
    """Up to the first NUL; what follows is stale by CODESYS's own rule. Not UTF-8: latin-1, which loses nothing."""
    data = data.partition(b"\0")[0]
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


def from_latin1(data: bytes | bytearray) -> str:
    """Up to the first NUL."""
    return data.partition(b"\0")[0].decode("latin-1")


def from_wide(data: bytes | bytearray) -> str:
    """Up to the first NUL unit; half a surrogate pair becomes U+FFFD."""
    return data.decode("utf-16-le", "replace").partition("\0")[0]


def texts(
    values: Iterable[str],
    encode: Callable[..., bytes],
    capacity: int,
    item_size: int,
    path: str,
    *cut: Late,
    exactly: int | None = None,
    at_most: int | None = None,
) -> bytes:
    """An array of strings, each NUL-padded to `item_size`; their number is the length by `item_size`.

    `encode` is one of the functions above, and `cut` what it is given behind the path.
    Raises CountExceeded and what `encode` raises.
    """
    if isinstance(values, (str, bytes)):
        raise OutOfRange(path, f"{type(values).__name__} where a sequence of strings is wanted")
    check_count(values, path, exactly, at_most)
    rows = (encode(value, capacity, f"{path}[{index}]", *cut) for index, value in enumerate(values))
    return b"".join(row.ljust(item_size, b"\0") for row in rows)


def from_texts(data: bytes | bytearray, decode: Callable[[bytes | bytearray], str], item_size: int) -> list[str]:
    """The strings in `data`, one in each `item_size` bytes; `decode` is one of the functions above."""
    return [decode(data[at : at + item_size]) for at in range(0, len(data), item_size)]


def _encoded(value: Any, encoding: str, path: str) -> bytes:
    if not isinstance(value, str):
        raise OutOfRange(path, f"{value!r:.40} is {type(value).__name__}, not str")
    if "\0" in value:
        raise OutOfRange(path, f"{value!r:.40} holds NUL, which ends a string in the PLC")
    try:
        return value.encode(encoding)
    except UnicodeEncodeError as error:
        raise OutOfRange(path, f"{value[error.start]!r} at {error.start} has no {encoding} encoding") from None


def _cut(kept: bytes, late: Late | None) -> bytes:
    if late is not None:
        late.append(CUT)
    return kept


def _too_long(path: str, length: int, capacity: int, unit: str) -> StringTooLong:
    return StringTooLong(path, f"{length} {unit}, capacity {capacity}")
