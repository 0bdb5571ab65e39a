"""Compute the offsets of members as the PLC's compiler does, and compare the offsets with TwinCAT's .tmc file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from shmgen.core.plural import counted
from shmgen.plc.declarations import Declaration

Extent = tuple[int, int]
"""Offset and size of a member in bytes."""
NATURAL = 8
"""The largest alignment of any type, in bytes."""


class Converted(NamedTuple):
    """A data type that was converted to a message. `size` and `alignment` are in bytes.

    `least_pack` is the smallest pack_mode of a structure in which a member of this type keeps its padding. `sure` is
    False if the size depends on an empty structure, whose size in a PLC is not verified.
    """

    name: str
    text: str
    size: int
    alignment: int
    least_pack: int = 1
    sure: bool = True
    places: tuple[Extent, ...] = ()
    """The offset and size of each member. The members of base structures come first."""


EMPTY = Converted("", "", 0, 1)
"""The base of a structure without a base: the first member is at offset 0."""


class Sum:
    """Computes the offsets, the size and the alignment of a structure, from the sizes of its members.

    No member is aligned to more than `pack` bytes. The first member follows the structure `base`.
    """

    def __init__(self, pack: int, base: Converted = EMPTY) -> None:
        self.pack, self.at, self.most = pack, base.size, min(base.alignment, pack)
        self.places: list[Extent] = list(base.places)
        self._least_pack = base.least_pack

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sum) and (self.places, self.end()) == (other.places, other.end())

    def add(self, type_: Converted, many: int, begins: int = 1) -> bool:
        """Append a member. Its offset is a multiple of its alignment and of `begins` bytes.

        `many` is the length of an array, or 0 for a single value. Return True if `begins` changed the offset.
        """
        size, alignment = type_.size * (many or 1), min(type_.alignment, self.pack)
        usual, at = _round_up(self.at, alignment), _round_up(self.at, max(alignment, begins))
        self._least_pack = max(self._least_pack, type_.least_pack, _pack_with_padding(self.at, alignment))
        self.places.append((at, size))
        self.at = at + size
        self.most = max(self.most, alignment)
        return at != usual

    def end(self) -> tuple[int, int]:
        """Return the size and alignment of the structure in bytes."""
        return _round_up(max(self.at, 1), self.most), self.most

    @property
    def least_pack(self) -> int:
        """The smallest pack_mode that keeps all padding. A structure with a pack_mode of its own keeps its padding."""
        return 1 if self.pack != NATURAL else max(self._least_pack, _pack_with_padding(max(self.at, 1), self.most))


def _pack_with_padding(at: int, alignment: int) -> int:
    """Return the smallest pack_mode with the same padding between byte `at` and the next multiple of `alignment`."""
    return next(pack for pack in (1, 2, 4, NATURAL) if -at % pack == -at % alignment)


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
