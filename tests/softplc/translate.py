"""Translates Structured Text to equivalent C++17, in units that are compiled separately."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from tests.softplc.declarations import Block, Declaration, Enumeration, Globals, Structure, collect_declarations
from tests.softplc.expressions import type_name, variable
from tests.softplc.iec import Array, Elementary, Named, Type
from tests.softplc.objects import Rows, declaration, definitions, owners, rows
from tests.softplc.reading import Unsupported, read

_UNIT = 250_000
"""The number of characters in a unit, which takes the compiler some seconds."""
_NAME = re.compile(r"\b[Tv]_\w+")


@dataclass(frozen=True)
class Translation:
    """`types` are the members' types by owner, and `enumerations` are the base types by name."""

    units: tuple[str, ...]
    types: Mapping[str, Mapping[str, Type]]
    enumerations: Mapping[str, Elementary]


def translate(files: Mapping[str, str]) -> Translation:
    """Translate files as an IDE exports them: METHODs after END_FUNCTION_BLOCK, variable lists named by their files.

    Raises Unsupported.
    """
    names = collect_declarations(read(files))
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
    """Finds the declarations that a text needs by the names in the text."""

    def __init__(self, declarations: Mapping[str, str], names: Mapping[str, Declaration]) -> None:
        self.declarations = declarations
        self.spelled = {type_name(name): name for name in names}
        self.spelled |= {variable(name): name for name, one in names.items() if isinstance(one, Globals)}
        self.direct = {name: self.find_names(text) for name, text in declarations.items()}
        self.forward = {name for name, one in names.items() if isinstance(one, Structure | Block)}

    def find_names(self, text: str) -> set[str]:
        return {self.spelled[word] for word in set(_NAME.findall(text)) if word in self.spelled}

    def of(self, text: str) -> Iterator[str]:
        """Yield the needed declarations in order. Structures are named first: pointers may refer to later ones."""
        needed: set[str] = set()
        new = self.find_names(text)
        while new:
            needed |= new
            new = set().union(*(self.direct[name] for name in new)) - needed
        yield from (f"struct {type_name(name)};" for name in sorted(needed & self.forward))
        yield from (text for name, text in self.declarations.items() if name in needed)


def _unit(number: int, objects: list[Declaration], code: list[str], needs: _Needs) -> str:
    all_rows = list(map(rows, objects))
    tables = []
    for row, table in zip(("Member", "Kind", "Entry"), Rows._fields, strict=True):
        lines = ",\n".join([*(line for rows in all_rows for line in getattr(rows, table)), "{}"])
        head = f"const {row} {table}_{number}[]"
        tables.append(f'extern "C" {{ extern {head}; {head} = {{\n{lines}\n}}; }}')
    text = "\n".join((*code, *tables))
    return "\n".join(('#include "runtime.hpp"', *needs.of(text), text, ""))


def _sorted(names: Mapping[str, Declaration]) -> list[Declaration]:
    """Sort types before the types that contain them, and variable lists last, because lists need all types."""
    done: dict[str, Declaration] = {}
    waiting: list[str] = []

    def visit(name: str) -> None:
        if name in waiting:
            raise Unsupported(f"{name} holds itself")
        if name in done:
            return
        waiting.append(name)
        for inner in _contained_types(names[name]):
            if inner not in names:
                raise Unsupported(f"{name}: there is no type {inner}")
            visit(inner)
        done[name] = names[waiting.pop()]

    for name in names:
        visit(name)
    return sorted(done.values(), key=lambda one: isinstance(one, Globals))


def _contained_types(one: Declaration) -> Iterator[str]:
    for _, variables in owners([one]):
        for member in variables:
            type_ = member.type
            while isinstance(type_, Array):
                type_ = type_.of
            if isinstance(type_, Named):
                yield type_.name
