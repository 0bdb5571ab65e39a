"""Generate the files in `st/shmgen/`, which all messages share: the header of a region, constants, and shared blocks.

The byte layout of the headers comes from `core/abi.py`. The blocks and enumerations are handwritten, in
`templates/st/`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from shmgen.core import abi
from shmgen.core.abi import HeaderField, Number
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
from shmgen.targets.st.text import MADE

TYPES = {"dw": "DWORD", "ui": "UINT", "udi": "UDINT", "lw": "LWORD", "aby": "ARRAY[0..{last}] OF BYTE"}
"""The IEC type for each name prefix."""
_HEADER = (
    f"// The first {abi.HEADER_SIZE} bytes of a region, ABI {abi.ABI}. "
    "The comment of a member begins with its offset, a multiple of its",
    "// size: pack_mode 8 adds no gap, and the compiler reads and writes each member with one access.",
    MADE,
)
_SLOT = (f"// The header of each slot in a region, {abi.SLOT_HEADER} bytes before the payload.", MADE)
_NUMBERS = (f"// The constants of the protocol, ABI {abi.ABI}. Names that end with _MS are in milliseconds.", MADE)


def plan(*, locks: bool, struct_time: bool) -> Iterator[Output]:
    """Yield the files that all messages share.

    If `locks` is true, regions have a lock. If `struct_time` is true, a structure represents a time.
    """
    yield header_structure("ST_ShmHeader", _HEADER, abi.HEADER, abi.HEADER_SIZE)
    yield header_structure("ST_ShmSlot", _SLOT, abi.SLOT, abi.SLOT_HEADER)
    yield numbers(abi.NUMBERS, locks)
    yield from by_hand("E_ShmError", "E_ShmState", "FB_ShmRegion", "GVL_ShmClock", *([ST_TIME] if struct_time else []))


def by_hand(*names: str) -> Iterator[Output]:
    """Yield the handwritten files `templates/st/<name>.st`, unchanged."""
    for name in names:
        yield Output(f"st/shmgen/{name}.st", f"st/{name}.st", None)


def header_structure(name: str, doc: tuple[str, ...], fields: Sequence[HeaderField], size: int) -> Output:
    """Return the file of the structure `name` of `size` bytes, whose members are the header fields `fields`.

    `doc` contains the comment lines at the start of the file.
    """
    members = [
        Variable(word.st, _type(word), comment=(f"// {word.offset:>3}: {word.meaning}",))
        for word in abi.with_reserved(fields, size)
    ]
    stored = DataType(name, Head(doc, (Attribute("pack_mode", "8"),)), tuple(members))
    return Output(f"st/shmgen/{name}.st", "st/dut.st.j2", Dut(stored, columns(members)))


def numbers(constants: Sequence[Number], locks: bool) -> Output:
    """Return the file with the list of the protocol's constants that a PLC needs.

    The additional constant LOCKS has the value of `locks`.
    """
    variables = [
        Variable(number.name, number.st, _value(number), (f"// {number.meaning}",)) for number in constants if number.st
    ]
    meaning = '// TRUE: a semaphore locks each region; FALSE: sync = "sequence" in shmgen.toml'
    variables.append(Variable("LOCKS", "BOOL", str(locks).upper(), (meaning,)))
    head = Head(_NUMBERS, (Attribute("qualified_only"),))
    stored = GlobalList(GVL_REGION, head, Variables("VAR_GLOBAL", True, tuple(variables)))
    return Output(f"st/shmgen/{GVL_REGION}.st", "st/gvl.st.j2", Gvl(stored, columns(variables)))


def columns(variables: Sequence[Variable]) -> tuple[Line, ...]:
    """Return declaration lines with name, type and comment in aligned columns."""
    width = max(len(variable.name) for variable in variables)
    codes = [variable.code(width) for variable in variables]
    column = max(map(len, codes))
    return tuple(Line(f"{code:<{column}}  {it.comment[0]}") for code, it in zip(codes, variables, strict=True))


def _type(word: HeaderField) -> str:
    prefix = word.st[: next(place for place, char in enumerate(word.st) if char.isupper())]
    return TYPES[prefix].format(last=word.length - 1)


def _value(number: Number) -> str:
    return f"16#{number.value:08X}" if number.value > 0x7FFFFFFF or number.st == "DWORD" else str(number.value)
