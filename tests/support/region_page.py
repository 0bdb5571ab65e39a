"""The tables of docs/protocol.md, from abi.py."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from shmgen.core import abi
from shmgen.core.abi import HeaderField, Number


def tables(
    header: Sequence[HeaderField] = abi.HEADER,
    slot: Sequence[HeaderField] = abi.SLOT,
    numbers: Sequence[Number] = abi.NUMBERS,
) -> Iterator[list[str]]:
    """Yield each table as a list of lines, including its head."""
    yield _words("offset", header)
    yield _words("offset in a slot", slot)
    rows = [f"| `{it.name}` | {_spelled(it)} | {it.meaning} |" for it in numbers]
    yield ["| name | value | meaning |", "|---|---|---|", *rows]


def with_tables(page: str, new_tables: Iterator[list[str]]) -> str:
    """Return the page with its tables replaced by those of `new_tables` that have the same heads."""
    for table in new_tables:
        lines = page.split("\n")
        start = lines.index(table[0])
        rest = itertools.dropwhile(lambda line: line.startswith("|"), lines[start:])
        page = "\n".join([*lines[:start], *table, *rest])
    return page


def _words(where: str, words: Sequence[HeaderField]) -> list[str]:
    rows = [f"| {word.offset} | {word.type} | {word.name} | {word.by} | {word.meaning} |" for word in words]
    return [f"| {where} | type | name | written by | meaning |", "|---|---|---|---|---|", *rows]


def _spelled(number: Number) -> str:
    unit = " ms" if number.name.endswith("_MS") else ""
    return f"16#{number.value:08X}" if number.value > 0xFFFF else f"{number.value}{unit}"
