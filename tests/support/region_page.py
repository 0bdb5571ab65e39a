"""The tables of docs/protocol.md, from abi.py."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from shmgen.core import abi
from shmgen.core.abi import Number, Word


def tables(
    header: Sequence[Word] = abi.HEADER, slot: Sequence[Word] = abi.SLOT, numbers: Sequence[Number] = abi.NUMBERS
) -> Iterator[list[str]]:
    """Line by line, each with a head of its own."""
    yield _words("offset", header)
    yield _words("in a slot", slot)
    rows = [f"| `{it.name}` | {_shown(it)} | {it.meaning} |" for it in numbers]
    yield ["| name | value | meaning |", "|---|---|---|", *rows]


def with_tables(page: str, made: Iterator[list[str]]) -> str:
    """The page with these tables in place of those that have the same heads."""
    for table in made:
        lines = page.split("\n")
        start = lines.index(table[0])
        rest = itertools.dropwhile(lambda line: line.startswith("|"), lines[start:])
        page = "\n".join([*lines[:start], *table, *rest])
    return page


def _words(where: str, words: Sequence[Word]) -> list[str]:
    rows = [f"| {word.offset} | {word.type} | {word.name} | {word.by} | {word.meaning} |" for word in words]
    return [f"| {where} | type | name | written by | meaning |", "|---|---|---|---|---|", *rows]


def _shown(number: Number) -> str:
    unit = " ms" if number.name.endswith("_MS") else ""
    return f"16#{number.value:08X}" if number.value > 0xFFFF else f"{number.value}{unit}"
