"""Convert types, values and comments of a definition to C and C++, and escape text that could end a comment."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from shmgen.core.model import Clock, Constant, Element, Layout, Ref, Scalar, String, TypeOptions, assert_never
from shmgen.core.plural import counted
from shmgen.targets.c.names import struct_name

_TYPES = {
    Scalar.BOOL: "uint8_t",
    Scalar.FLOAT32: "float",
    Scalar.FLOAT64: "double",
}
_CLOCKS = {"TIME": "uint32_t", "LTIME": "uint64_t", "struct": "shmgen_seconds"}


class Head(NamedTuple):
    """The template data for the start of a header: the comment, the include guard and the included files."""

    summary: str
    origin: str
    guard: str
    includes: tuple[str, ...]


def head(summary: str, origin: str, path: str, includes: Iterable[str]) -> Head:
    """Return the start of the header `path`, which is generated from the definition in `origin`."""
    guard = path.upper().replace("/", "_").replace(".", "_")
    return Head(summary, in_comment(origin), guard, tuple(includes))


def message_head(layout: Layout, path: str, includes: Iterable[str]) -> Head:
    """Return the start of the header `path` with the structure or class of a message."""
    size = f"{counted(layout.size, 'byte')}, layout digest {layout.digest:016x}"
    summary = f"{layout.name} in shared memory: {size}. The comment of a member begins with its offset in bytes."
    return head(summary, layout.message.origin, path, includes)


def element(type_: Element, options: TypeOptions) -> str:
    """Return the C type of one element. For a string, return the type of a character."""
    match type_:
        case Scalar():
            return _TYPES.get(type_, f"{type_.value}_t")
        case Clock():
            return _CLOCKS[options.time]
        case String(_, wide):
            return "uint16_t" if wide else "char"
        case Ref(name):
            return struct_name(name)
        case _:
            assert_never(type_)


def in_comment(text: str) -> str:
    """Return text that is safe in a C comment: it cannot end the comment, begin another one or join lines.

    A blank splits the marks of comments, and the trigraph `??/`. C11 reads this trigraph as a backslash, which would
    join two lines if it is the last character of a line.
    """
    printable = "".join(sign if sign.isprintable() or sign == "\n" else " " for sign in text)
    return printable.replace("??/", "? ?/").replace("*/", "* /").replace("/*", "/ *").rstrip()


def literal(constant: Constant, options: TypeOptions) -> str:
    value = constant.value
    match constant.type:
        case String(_, wide):
            return quoted_wide(str(value)) if wide else quoted(str(value).encode(options.encoding))
        case Scalar.FLOAT32 | Scalar.FLOAT64:
            number = float(value)
            text = {"inf": "1.0 / 0.0", "-inf": "-1.0 / 0.0", "nan": "0.0 / 0.0"}.get(repr(number), repr(number))
            return f"(({_TYPES[constant.type]})({text}))"
        case Scalar() as scalar:
            number = int(value)
            suffix = "ULL" if scalar is Scalar.UINT64 else "LL" if scalar.size > 4 or number < -(2**31) + 1 else ""
            text = f"{number}{suffix}" if number > -(2**63) else f"{number + 1}{suffix} - 1"
            return f"(({_TYPES.get(scalar, f'{scalar.value}_t')})({text}))"
        case _:
            assert_never(constant.type)


_PLAIN = set(range(0x20, 0x7F)) - set(b'"\\?')
"""The ASCII characters that need no escape. `?` is excluded, because it could form a trigraph."""


def quoted(text: bytes) -> str:
    """Return a C string literal. Bytes outside 0x20 .. 0x7E, `"`, `?` and backslashes become octal escapes."""
    return '"' + "".join(chr(byte) if byte in _PLAIN else f"\\{byte:03o}" for byte in text) + '"'


def quoted_wide(text: str) -> str:
    """Return a char16_t literal that escapes the same characters as quoted().

    Characters below U+00A0 get octal escapes, and all others get universal character names. C and C++ do not allow
    universal character names for most characters below U+00A0.
    """
    return 'u"' + "".join(_wide(ord(char)) for char in text) + '"'


def _wide(code: int) -> str:
    if code in _PLAIN:
        return chr(code)
    return f"\\{code:03o}" if code < 0xA0 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
