"""Writes the region of abi.py in Structured Text, and adds the blocks and enumerations written by hand.

All of it is common to a project's messages and stands in `st/shmgen/`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from shmgen.core import abi
from shmgen.core.abi import Number, Word
from shmgen.core.model import Output
from shmgen.targets.st.names import GVL_REGION, ST_TIME
from shmgen.targets.st.objects import (
    Attribute,
    DataType,
    Dut,
    GlobalList,
    Gvl,
    Head,
    Line,
    Variable,
    Variables,
)
from shmgen.targets.st.text import MADE, uncommented

TYPES = {"dw": "DWORD", "ui": "UINT", "udi": "UDINT", "lw": "LWORD", "aby": "ARRAY[0..{last}] OF BYTE"}
"""What the prefix of a name says."""
_HEADER = (
    f"// The first {abi.HEADER_SIZE} bytes of a region, ABI {abi.ABI}. "
    "Every word lies at a multiple of its own size, so that pack_mode 8",
    "// leaves no gap and the compiler reads and writes each with one access.",
    MADE,
)
_SLOT = (f"// What stands before the payload in each slot of a region, {abi.SLOT_HEADER} bytes.", MADE)
_NUMBERS = (f"// What both ends of a region must know, ABI {abi.ABI}; all ..._MS are milliseconds.", MADE)


def plan(*, locks: bool, struct_time: bool) -> Iterator[Output]:
    """`locks`: regions have a lock; `struct_time`: times are structures."""
    yield words("ST_ShmHeader", _HEADER, abi.HEADER, abi.HEADER_SIZE)
    yield words("ST_ShmSlot", _SLOT, abi.SLOT, abi.SLOT_HEADER)
    yield numbers(abi.NUMBERS, locks)
    yield from by_hand("E_ShmError", "E_ShmState", "FB_ShmRegion", "GVL_ShmClock", *([ST_TIME] if struct_time else []))


def by_hand(*names: str) -> Iterator[Output]:
    """Objects that stand in templates/st/ as they are."""
    for name in names:
        yield Output(f"st/shmgen/{name}.st", f"st/{name}.st", None)


def words(name: str, doc: tuple[str, ...], found: Sequence[Word], size: int) -> Output:
    """A structure of `size` bytes with these words."""
    members = [
        Variable(word.st, _type(word), "", f"{word.offset:>3}  {word.meaning}") for word in abi.tiled(found, size)
    ]
    stored = DataType(name, Head(uncommented(doc), (Attribute("pack_mode", "8"),)), _plain(members))
    return Output(f"st/shmgen/{name}.st", "st/dut.st.j2", Dut(stored, doc, _columns(members)))


def numbers(found: Sequence[Number], locks: bool) -> Output:
    """The list of what a PLC needs of these, and LOCKS."""
    constants = [Variable(number.name, number.st, _value(number), number.meaning) for number in found if number.st]
    constants.append(Variable("LOCKS", "BOOL", str(locks).upper(), 'FALSE: sync = "sequence", no semaphore at all'))
    head = Head(uncommented(_NUMBERS), (Attribute("qualified_only"),))
    stored = GlobalList(GVL_REGION, head, Variables("VAR_GLOBAL", True, _plain(constants)))
    return Output(f"st/shmgen/{GVL_REGION}.st", "st/gvl.st.j2", Gvl(stored, _NUMBERS, _columns(constants)))


def _plain(found: Sequence[Variable]) -> tuple[Variable, ...]:
    return tuple(variable._replace(comment=variable.comment.strip()) for variable in found)


def _columns(found: Sequence[Variable]) -> tuple[Line, ...]:
    """Name, declaration and comment, lined up."""
    width = max(len(variable.name) for variable in found)
    codes = [f"{it.name:<{width}} : {it.type}{f' := {it.value}' if it.value else ''};" for it in found]
    column = max(map(len, codes))
    return tuple(Line(f"{code:<{column}}  // {it.comment}") for code, it in zip(codes, found, strict=True))


def _type(word: Word) -> str:
    prefix = word.st[: next(place for place, char in enumerate(word.st) if char.isupper())]
    return TYPES[prefix].format(last=word.length - 1)


def _value(number: Number) -> str:
    return f"16#{number.value:08X}" if number.value > 0x7FFFFFFF or number.st == "DWORD" else str(number.value)
