"""Makes text that others wrote safe for a terminal, which shows it and does not obey it."""

from __future__ import annotations


def legible(text: str) -> str:
    """Control characters, line ends and marks that turn the way of writing by their numbers; the rest as it is."""
    return text if text.isprintable() else "".join(map(escaped, text))


def lines(text: str) -> str:
    """The same, line by line."""
    return "\n".join(map(legible, text.split("\n")))


def escaped(sign: str) -> str:
    """One character, as YAML and Python spell it."""
    if sign.isprintable():
        return sign
    return f"\\u{ord(sign):04x}" if ord(sign) < 0x10000 else f"\\U{ord(sign):08x}"
