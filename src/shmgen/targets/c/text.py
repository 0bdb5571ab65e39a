"""Types, values and words of a definition as C and C++ take them: text that stays where it stands."""

from __future__ import annotations

from shmgen.core.model import Clock, Constant, Element, Ref, Scalar, String, TypeOptions, assert_never
from shmgen.targets.c.names import struct_name

_TYPES = {
    Scalar.BOOL: "uint8_t",
    Scalar.FLOAT32: "float",
    Scalar.FLOAT64: "double",
}
_CLOCKS = {"TIME": "uint32_t", "LTIME": "uint64_t", "struct": "shmgen_seconds"}


def element(type_: Element, options: TypeOptions) -> str:
    """The C type of one element; a string's is that of a character."""
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
    """Text that can neither end the comment it stands in nor begin another; `??/` is a backslash to C11."""
    printable = "\n".join(map(_printable, text.split("\n")))
    return printable.replace("??/", "? ?/").replace("*/", "* /").replace("/*", "/ *").rstrip()


def _printable(line: str) -> str:
    return line if line.isprintable() else "".join(sign if sign.isprintable() else " " for sign in line)


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
"""`?` is none, against trigraphs."""


def quoted(text: bytes) -> str:
    """A C string literal: all but plain ASCII as three octal digits."""
    return '"' + "".join(chr(byte) if byte in _PLAIN else f"\\{byte:03o}" for byte in text) + '"'


def quoted_wide(text: str) -> str:
    """A char16_t literal. Octal below U+00A0, where the standards have no universal character names."""
    return 'u"' + "".join(_wide(ord(char)) for char in text) + '"'


def _wide(code: int) -> str:
    if code in _PLAIN:
        return chr(code)
    return f"\\{code:03o}" if code < 0xA0 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
