"""Numbers with the word for what they count."""

from __future__ import annotations


def counted(number: int, what: str) -> str:
    """`1 byte`, `4,096 bytes`, `2 processes`."""
    ending = "" if number == 1 else "es" if what.endswith("s") else "s"
    return f"{number:,} {what}{ending}"
