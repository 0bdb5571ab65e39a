"""Translates Structured Text to C++17 that does the same, in some units that are compiled on their own."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from tests.softplc.declarations import Block, Declaration, Enumeration, Globals, Structure, declared
from tests.softplc.expressions import type_name, variable
from tests.softplc.iec import Array, Elementary, Named, Type
from tests.softplc.objects import Rows, declaration, definitions, owners, rows
from tests.softplc.reading import Unsupported, read

_UNIT = 250_000
"""Characters of code in one unit, which keep the compiler busy for some seconds."""
_NAME = re.compile(r"\b[Tv]_\w+")


@dataclass(frozen=True)
class Translation:
    """`types` are the members' types by owner, `enumerations` the base types."""

    units: tuple[str, ...]
    types: Mapping[str, Mapping[str, Type]]
    enumerations: Mapping[str, Elementary]


def translate(files: Mapping[str, str]) -> Translation:
    """`files` as an IDE exports them, METHODs after END_FUNCTION_BLOCK; a variable list has the name of its file.

    Raises Unsupported.
    """
    names = declared(read(files))
    declarations = {one.name: "\n".join(declaration(one, names)) for one in _sorted(names)}
    needs = _Needs(declarations, names)
    units: list[str] = []
    pile: list[Declaration] = []
    code: list[str] = []
    for one in names.values():
        pile.append(one)
        code += definitions(one, names) if isinstance(one, Block) else []
        if sum(map(len, code)) > _UNIT or one is list(names.values())[-1]:
            units.append(_unit(len(units), pile, code, needs))
            pile, code = [], []
    return Translation(
        tuple(units),
        {owner: {one.name: one.type for one in variables} for owner, variables in owners(names.values())},
        {one.name: one.base for one in names.values() if isinstance(one, Enumeration)},
    )


class _Needs:
    """Which declarations a text needs, found by the names in it."""

    def __init__(self, declarations: Mapping[str, str], names: Mapping[str, Declaration]) -> None:
        self.declarations = declarations
        self.spelled = {type_name(name): name for name in names}
        self.spelled |= {variable(name): name for name, one in names.items() if isinstance(one, Globals)}
        self.direct = {name: self.found(text) for name, text in declarations.items()}
        self.forward = {name for name, one in names.items() if isinstance(one, Structure | Block)}

    def found(self, text: str) -> set[str]:
        return {self.spelled[word] for word in set(_NAME.findall(text)) if word in self.spelled}

    def of(self, text: str) -> Iterator[str]:
        """The declarations in order; the structures' names first, because pointers may refer to later ones."""
        needed: set[str] = set()
        new = self.found(text)
        while new:
            needed |= new
            new = set().union(*(self.direct[name] for name in new)) - needed
        yield from (f"struct {type_name(name)};" for name in sorted(needed & self.forward))
        yield from (text for name, text in self.declarations.items() if name in needed)


def _unit(number: int, objects: list[Declaration], code: list[str], needs: _Needs) -> str:
    found = list(map(rows, objects))
    tables = []
    for row, table in zip(("Member", "Kind", "Entry"), Rows._fields, strict=True):
        lines = ",\n".join([*(line for rows in found for line in getattr(rows, table)), "{}"])
        head = f"const {row} {table}_{number}[]"
        tables.append(f'extern "C" {{ extern {head}; {head} = {{\n{lines}\n}}; }}')
    text = "\n".join((*code, *tables))
    return "\n".join(('#include "runtime.hpp"', *needs.of(text), text, ""))


def _sorted(names: Mapping[str, Declaration]) -> list[Declaration]:
    """What is held before what holds it, and variable lists last, because they need everything."""
    done: dict[str, Declaration] = {}
    waiting: list[str] = []

    def visit(name: str) -> None:
        if name in waiting:
            raise Unsupported(f"{name} holds itself")
        if name in done:
            return
        waiting.append(name)
        for held in _holds(names[name]):
            if held not in names:
                raise Unsupported(f"{name}: there is no type {held}")
            visit(held)
        done[name] = names[waiting.pop()]

    for name in names:
        visit(name)
    return sorted(done.values(), key=lambda one: isinstance(one, Globals))


def _holds(one: Declaration) -> Iterator[str]:
    for _, variables in owners([one]):
        for member in variables:
            type_ = member.type
            while isinstance(type_, Array):
                type_ = type_.of
            if isinstance(type_, Named):
                yield type_.name
