"""Escape text from other programs, so that a terminal prints its control characters and does not execute them."""

from __future__ import annotations


def legible(text: str) -> str:
    """Return `text` with control characters, line ends and direction marks replaced by escape sequences."""
    return text if text.isprintable() else "".join(map(escaped, text))


def lines(text: str) -> str:
    """Return `text` with the control characters and direction marks of each line escaped. Keep the line ends."""
    return "\n".join(map(legible, text.split("\n")))


def escaped(sign: str) -> str:
    """Return a printable character unchanged, and any other as the escape sequence of YAML and Python."""
    if sign.isprintable():
        return sign
    return f"\\u{ord(sign):04x}" if ord(sign) < 0x10000 else f"\\U{ord(sign):08x}"
