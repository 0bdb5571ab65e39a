"""Compute the offsets of members as the PLC's compiler does, and compare the offsets with TwinCAT's .tmc file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from shmgen.core.plural import counted
from shmgen.plc import types
from shmgen.plc.declarations import Declaration
from shmgen.plc.numbers import NotConvertible

Extent = tuple[int, int]
"""Offset and size of a member in bytes."""
PACKS = (1, 2, 4)
NATURAL = 8
"""The largest alignment of any type, in bytes."""


class Converted(NamedTuple):
    """A data type that was converted to a message. `size` and `alignment` are in bytes.

    `sure` is False if the size depends on an empty structure, whose size in a PLC is not verified.
    """

    name: str
    text: str
    size: int
    alignment: int
    packed: dict[int, tuple[int, int]]
    """pack_mode -> size and alignment of this type inside a structure with that pack_mode."""
    sure: bool = True
    places: tuple[Extent, ...] = ()
    """The offset and size of each member. The members of base structures come first."""


def packed(size: int, alignment: int) -> dict[int, tuple[int, int]]:
    """Map each pack_mode to the size and alignment of a type with fixed bytes inside a structure packed that way."""
    return {pack: (size, min(alignment, pack)) for pack in PACKS}


class _Sum:
    """Computes the offsets, the size and the alignment of a structure, from the sizes of its members.

    No member is aligned to more than `pack` bytes. The first member follows a base structure, which has `at` bytes,
    the alignment `alignment` and the members `places`.
    """

    def __init__(self, pack: int, at: int = 0, alignment: int = 1, places: tuple[Extent, ...] = ()) -> None:
        self.pack, self.at, self.most = pack, at, min(alignment, pack)
        self.places: list[Extent] = list(places)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Sum) and (self.places, self.end()) == (other.places, other.end())

    def add(self, size: int, alignment: int, begins: int = 1) -> bool:
        """Append a member of `size` bytes. Its offset is a multiple of its alignment and of `begins` bytes.

        Return True if `begins` changed the offset of the member.
        """
        alignment = min(alignment, self.pack)
        usual, at = _round_up(self.at, alignment), _round_up(self.at, max(alignment, begins))
        self.places.append((at, size))
        self.at = at + size
        self.most = max(self.most, alignment)
        return at != usual

    def end(self) -> tuple[int, int]:
        """Return the size and alignment of the structure in bytes."""
        return _round_up(max(self.at, 1), self.most), self.most


class Sums:
    """Computes the layout of a structure under different rules, so that the import can reject a structure that differs.

    `compiled` is the layout by the PLC's compiler, `message` the layout by the message definition, and `natural` the
    layout without pack_mode. `within` maps each pack_mode to the compiler's layout of this structure inside another
    structure with that pack_mode.
    """

    def __init__(self, pack: int, base: Converted) -> None:
        self.compiled = _Sum(pack, base.size, base.alignment, base.places)
        self.message, self.natural = _Sum(pack), _Sum(NATURAL)
        self.within = {pack: _Sum(pack, *base.packed[pack]) for pack in PACKS}

    def add(self, type_: Converted, many: int, begins: int, *, is_own: bool) -> bool:
        """Append a member to all layouts. `many` is the length of an array, or 0 for a single value.

        `is_own` is True for a member of the structure itself, and False for a member of a structure that it extends.
        The member begins at a multiple of `begins` bytes. Return True if `begins` changed the offset of the member in
        `message`. Raises NotConvertible if the structure becomes too large.
        """
        size = type_.size * (many or 1)
        moved = self.message.add(size, type_.alignment, begins)
        self.natural.add(size, type_.alignment, begins)
        if is_own:
            self.compiled.add(size, type_.alignment)
            for pack, total in self.within.items():
                inner, alignment = type_.packed[pack]
                total.add(inner * (many or 1), alignment)
        if self.message.at > types.LARGEST:
            raise NotConvertible(f"more than {types.LARGEST:,} bytes", "declare a smaller type", "SHM303")
        return moved

    def packed(self) -> dict[int, tuple[int, int]]:
        """Map each pack_mode to the size and alignment of this type inside a structure with that pack_mode."""
        if self.compiled.pack != NATURAL:
            return packed(*self.compiled.end())
        return {pack: total.end() for pack, total in self.within.items()}


EMPTY = Converted("", "", 0, 1, packed(0, 1))
"""The base of a structure without a base: the first member is at offset 0."""


def _round_up(number: int, alignment: int) -> int:
    return -(-number // alignment) * alignment


class Compiled(NamedTuple):
    """The layout of a data type in a .tmc file, in bits: its size, and the offset and size of its own members.

    The keys of `members` are in capital letters.
    """

    file: str
    size: int
    members: Mapping[str, Extent]

    def has_all(self, declared: Declaration) -> bool:
        """Return False for a structure whose members the file does not list, as TwinCAT does for some structures."""
        return bool(self.members) or declared.kind != "struct" or not declared.members


def differences(declared: Declaration, converted: Converted, compiled: Compiled) -> Iterator[str]:
    """Yield a line for each member whose offset or size in the .tmc file differs from the converted message.

    If the total sizes differ, yield another line.
    """
    own = converted.places[len(converted.places) - len(declared.members) :]
    if compiled.members:
        spelled = {member.name.upper(): member.name for member in declared.members}
        ours = {name: (8 * at, 8 * size) for name, (at, size) in zip(spelled, own, strict=False)}
        for name in {**ours, **compiled.members}:
            here, there = ours.get(name), compiled.members.get(name)
            if here != there:
                yield f"{spelled.get(name, name)}: {_extent(here)} here, {_extent(there)} in {compiled.file}"
    if compiled.size != 8 * converted.size:
        yield f"total size: {_size(8 * converted.size)} here, {_size(compiled.size)} in {compiled.file}"


def _extent(extent: Extent | None) -> str:
    if extent is None:
        return "absent"
    at, size = extent
    return f"{_size(size)} at {f'byte {at // 8}' if at % 8 == 0 else f'bit {at}'}"


def _size(bits: int) -> str:
    return counted(bits // 8, "byte") if bits % 8 == 0 else counted(bits, "bit")
