"""Read and write TOML. The parser is the module tomllib, or tomli on a Python without tomllib."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Mapping
from typing import Any


def loads(text: str) -> dict[str, Any]:
    """Parse a TOML document. Raises ValueError, whose text ends with the place if known: `(at line 3, column 5)`."""
    if sys.version_info >= (3, 11):  # loaded here, because a run without shmgen.toml parses no TOML
        import tomllib
    else:
        import tomli as tomllib
    try:
        document: dict[str, Any] = tomllib.loads(text)
    except RecursionError:
        raise ValueError("brackets are nested too deeply") from None
    return document


def dumps(document: Mapping[str, Any]) -> str:
    """Return the text of a TOML document. Only the kinds of values and tables that shmgen.toml has are supported."""
    return "\n".join(_table("", document)).strip("\n") + "\n"


def _table(name: str, table: Mapping[str, Any]) -> Iterator[str]:
    inner = {key: value for key, value in table.items() if isinstance(value, dict)}
    lists = {key: value for key, value in table.items() if isinstance(value, list) and any(map(_is_table, value))}
    for key, value in table.items():
        if key not in inner and key not in lists:
            yield f"{_key(key)} = {_value(value)}"
    for key, value in inner.items():
        yield f"\n[{name}{_key(key)}]"
        yield from _table(f"{name}{_key(key)}.", value)
    for key, values in lists.items():
        for value in values:
            yield f"\n[[{name}{_key(key)}]]"
            yield from _table(f"{name}{_key(key)}.", value)


def _is_table(value: object) -> bool:
    return isinstance(value, dict)


def _key(word: str) -> str:
    return word if re.fullmatch("[A-Za-z0-9_-]+", word) else _value(word)


def _value(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    # JSON has the same words for these, but leaves DEL as it stands, which TOML forbids.
    return repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
