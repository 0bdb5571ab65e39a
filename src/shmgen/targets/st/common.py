"""Turns the region of abi.py into Structured Text, and adds the blocks and enumerations that are written by hand.

All of it is common to a project's messages and stands in `st/shmgen/`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen import abi
from shmgen.abi import Number, Word
from shmgen.model import Output
from shmgen.targets import naming

TYPES = {"dw": "DWORD", "ui": "UINT", "udi": "UDINT", "lw": "LWORD", "aby": "ARRAY[0..{last}] OF BYTE"}
"""What the prefix of a name says."""
_HEADER = """\
// The first {size} bytes of a region, ABI {abi}. Every word lies at a multiple of its own size, so that pack_mode 8
// leaves no gap and the compiler reads and writes each with one access."""
_SLOT = "// What stands before the payload in each slot of a region, {size} bytes."


class Words(NamedTuple):
    """A structure; `title` and `members` are lines."""

    title: str
    name: str
    members: tuple[str, ...]


class Numbers(NamedTuple):
    """The list of constants, a line each."""

    abi: str
    constants: tuple[str, ...]


def plan(*, locks: bool, struct_time: bool) -> Iterator[Output]:
    """`locks`: regions have a lock; `struct_time`: times are structures."""
    yield words("ST_ShmHeader", _HEADER, abi.HEADER, abi.HEADER_SIZE)
    yield words("ST_ShmSlot", _SLOT, abi.SLOT, abi.SLOT_HEADER)
    yield numbers(abi.NUMBERS, locks)
    yield from by_hand("E_ShmError", "E_ShmState", "FB_ShmRegion", *([naming.ST_TIME] if struct_time else []))


def by_hand(*names: str) -> Iterator[Output]:
    """Objects that stand in templates/st/ as they are."""
    for name in names:
        yield Output(f"st/shmgen/{name}.st", f"st/{name}.st", None)


def words(name: str, title: str, found: Sequence[Word], size: int) -> Output:
    """A structure of `size` bytes with these words."""
    tiled = list(abi.tiled(found, size))
    rows = [(word.st, f" : {_type(word)};", f"{word.offset:>3}  {word.meaning}") for word in tiled]
    view = Words(title.format(size=size, abi=abi.ABI), name, _columns(rows))
    return Output(f"st/shmgen/{name}.st", "st/words.st.j2", view)


def numbers(found: Sequence[Number], locks: bool) -> Output:
    """The list of what a PLC needs of these, and LOCKS."""
    rows = [(it.name, f" : {it.st} := {_value(it)};", it.meaning) for it in found if it.st]
    rows.append(("LOCKS", f" : BOOL := {str(locks).upper()};", 'FALSE: sync = "sequence", no semaphore at all'))
    view = Numbers(str(abi.ABI), _columns(rows))
    return Output(f"st/shmgen/{naming.GVL_REGION}.st", "st/numbers.st.j2", view)


def _columns(rows: Sequence[tuple[str, str, str]]) -> tuple[str, ...]:
    """Name, declaration and comment, lined up."""
    width = max(len(name) for name, *_ in rows)
    column = width + max(len(code) for _, code, _ in rows)
    return tuple(f"{f'{name:<{width}}{code}':<{column}}  // {comment}" for name, code, comment in rows)


def _type(word: Word) -> str:
    prefix = word.st[: next(place for place, char in enumerate(word.st) if char.isupper())]
    return TYPES[prefix].format(last=word.length - 1)


def _value(number: Number) -> str:
    return f"16#{number.value:08X}" if number.value > 0x7FFFFFFF or number.st == "DWORD" else str(number.value)
