"""Format a number together with the noun that it counts."""

from __future__ import annotations


def counted(number: int, what: str) -> str:
    """Return `number` with the noun `what` in singular or plural: `1 byte`, `4,096 bytes`, `2 processes`."""
    ending = "" if number == 1 else "es" if what.endswith("s") else "s"
    return f"{number:,} {what}{ending}"
