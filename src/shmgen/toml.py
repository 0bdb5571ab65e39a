"""Turns TOML into tables: the one place that knows which Python has a reader, and what is too deep for it."""

from __future__ import annotations

import sys
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def loads(text: str) -> dict[str, Any]:
    """Raises ValueError; where the fault has a place, the message ends with `(at line 3, column 5)` or the like."""
    try:
        document: dict[str, Any] = tomllib.loads(text)
    except RecursionError:
        raise ValueError("brackets are nested too deeply") from None
    return document
