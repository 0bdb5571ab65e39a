"""Convert strings to the bytes of a STRING or WSTRING, and back."""

from __future__ import annotations

from typing import Any, NamedTuple

from shmgen.runtime.errors import OutOfRange, StringTooLong


class TextKind(NamedTuple):
    """The encoding of one type of string, and how shmgen handles a string that is too long.

    `unit` is the size of a code unit in bytes. `counted` names the units of a capacity in error messages, such as
    "bytes of UTF-8". If `truncates` is True, a string that is too long is truncated.
    """

    encoding: str
    unit: int
    counted: str
    truncates: bool


_KINDS = {
    "utf-8": TextKind("utf-8", 1, "bytes of UTF-8", False),
    "latin-1": TextKind("latin-1", 1, "characters", False),
    "utf-16": TextKind("utf-16-le", 2, "UTF-16 code units", False),
}
TEXTS = _KINDS | {f"{name} truncated": kind._replace(truncates=True) for name, kind in _KINDS.items()}


def encode_text(kind: str, value: Any, size: int, path: str) -> tuple[bytes, bool]:
    """Return the bytes of a string without the terminating NUL, and True if the string was truncated.

    `size` is the size of the field in bytes, including the NUL. If the string needs more bytes, truncate the string at
    the end of a character, or raise StringTooLong if `kind` forbids truncation. Raises OutOfRange if the value is no
    string.
    """
    encoding, unit, unit_name, truncates = TEXTS[kind]
    data = _encode(value, encoding, path)
    capacity = size - unit
    if len(data) <= capacity:
        return data, False
    if not truncates:
        raise StringTooLong(path, f"{len(data) // unit} {unit_name}, capacity {capacity // unit}")
    return data[:capacity].decode(encoding, "ignore").encode(encoding), True


def decode_text(kind: str, data: bytes | bytearray) -> str:
    """Return the string before the first NUL. CODESYS leaves old characters after the NUL.

    Bytes that are not valid UTF-8 are read as Latin-1, which loses nothing. Half a surrogate pair becomes U+FFFD.
    """
    if kind.startswith("utf-16"):
        return data.decode("utf-16-le", "replace").partition("\0")[0]
    data = data.partition(b"\0")[0]
    try:
        return data.decode(TEXTS[kind].encoding)
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _encode(value: Any, encoding: str, path: str) -> bytes:
    if not isinstance(value, str):
        raise OutOfRange(path, f"{value!r:.40} is {type(value).__name__}, not str")
    if "\0" in value:
        raise OutOfRange(path, f"{value!r:.40} contains NUL, which ends a string in the PLC")
    try:
        return value.encode(encoding)
    except UnicodeEncodeError as error:
        raise OutOfRange(path, f"{value[error.start]!r} at {error.start} has no {encoding} encoding") from None
