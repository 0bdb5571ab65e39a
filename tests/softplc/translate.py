"""Turns Structured Text into C++17 that does the same: one header with the types, and some units with the code."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from tests.softplc.declarations import Block, Declaration, Enumeration, Globals, Method, Structure, Variable, declared
from tests.softplc.expressions import Scope, cpp_type, method_name, type_name, variable
from tests.softplc.iec import Array, Elementary, Named, Type
from tests.softplc.reading import Unsupported, read
from tests.softplc.statements import statements

_UNIT = 60_000
"""Characters of code in one unit; the compiler takes about a second for them."""


@dataclass(frozen=True)
class Translation:
    """`types` are the members' types by owner; a method's parameters belong to `BLOCK.METHOD`."""

    header: str
    units: tuple[str, ...]
    types: Mapping[str, Mapping[str, Type]]
    enumerations: Mapping[str, Elementary]


def translate(files: Mapping[str, str]) -> Translation:
    """`files` as an IDE exports them, METHODs after END_FUNCTION_BLOCK; a variable list has the name of its file.

    Raises Unsupported.
    """
    names = declared(read(files))
    header = ["#pragma once", '#include "runtime.hpp"']
    # Pointers may refer to what comes later.
    header += [f"struct {type_name(name)};" for name, one in names.items() if isinstance(one, Structure | Block)]
    shared = _held(names)
    for one in _sorted(names):
        if not isinstance(one, Block) or one.name in shared:
            header += _declaration(one, names)
    header += [line for one in names.values() if isinstance(one, Globals) for line in _globals(one, names)]
    units = [_tables(0, [one for one in names.values() if not isinstance(one, Block)])]
    pile: list[tuple[Block, str]] = []
    blocks = [one for one in names.values() if isinstance(one, Block)]
    for block in blocks:
        own = [] if block.name in shared else _declaration(block, names)
        pile.append((block, "\n".join((*own, *_definitions(block, names)))))
        if block is blocks[-1] or sum(len(text) for _, text in pile) > _UNIT:
            units.append("\n".join((*(text for _, text in pile), _tables(len(units), [one for one, _ in pile]))))
            pile = []
    includes = '#include "types.hpp"\n'
    return Translation(
        "\n".join(header) + "\n",
        tuple(includes + unit for unit in units),
        {owner: {one.name: one.type for one in variables} for owner, variables in _owners(names.values())},
        {one.name: one.base for one in names.values() if isinstance(one, Enumeration)},
    )


# --- declarations -------------------------------------------------------------------------------------


def _held(names: Mapping[str, Declaration]) -> set[str]:
    """Types that another declaration holds."""
    return {held for one in names.values() for held in _holds(one)}


def _holds(one: Declaration) -> Iterator[str]:
    for _, variables in _owners([one]):
        for member in variables:
            type_ = member.type
            while isinstance(type_, Array):
                type_ = type_.of
            if isinstance(type_, Named):
                yield type_.name


def _sorted(names: Mapping[str, Declaration]) -> list[Declaration]:
    """What is held before what holds it."""
    done: dict[str, Declaration] = {}
    waiting: list[str] = []

    def visit(name: str) -> None:
        if name in waiting:
            raise Unsupported(f"{name} holds itself")
        if name in done or isinstance(names[name], Globals):
            return
        waiting.append(name)
        for held in _holds(names[name]):
            if held not in names:
                raise Unsupported(f"{name}: there is no type {held}")
            visit(held)
        done[name] = names[waiting.pop()]

    for name in names:
        visit(name)
    return list(done.values())


def _declaration(one: Declaration, names: Mapping[str, Declaration]) -> Iterator[str]:
    scope = Scope(names)
    match one:
        case Enumeration():
            spelled = ", ".join(
                variable(name) if value is None else f"{variable(name)} = {scope.expression(value)}.value"
                for name, value in one.values
            )
            yield f"enum class {type_name(one.name)} : {one.base.name} {{ {spelled} }};"
        case Structure():
            yield f"#pragma pack(push, {one.pack})"
            yield f"struct {type_name(one.name)} {{"
            yield from (f"    {_member(member, scope)}" for member in one.members)
            yield "};"
            yield "#pragma pack(pop)"
        case Block():
            yield f"struct {type_name(one.name)} {{"
            for member in one.variables:
                yield f"    {_member(member, scope)}"
            for method in one.methods.values():
                parameters = f"{method_name(method.name)}_parameters"
                yield f"    struct {parameters} {{"
                yield from (f"        {_member(member, scope)}" for member in _parameters(method))
                yield "    };"
                yield f"    void {method_name(method.name)}({parameters} &p);"
            yield "    void body();"
            yield "};"
        case Globals():
            raise AssertionError("lists come after all types")


def _globals(one: Globals, names: Mapping[str, Declaration]) -> Iterator[str]:
    yield f"struct {type_name(one.name)} {{"
    yield from (f"    {_member(member, Scope(names))}" for member in one.variables)
    yield "};"
    yield f"inline {'const ' * one.constant}{type_name(one.name)} {variable(one.name)}{{}};"


def _parameters(method: Method) -> tuple[Variable, ...]:
    result = () if method.result is None else (Variable(method.name, method.result, "output", None),)
    return (*method.parameters, *result)


def _member(member: Variable, scope: Scope) -> str:
    type_, name = cpp_type(member.type), variable(member.name)
    if member.section == "constant":
        return f"static inline const {type_} {name} = {_initial(member, scope)};"
    return f"{type_} {name} = {_initial(member, scope)};"


def _initial(member: Variable, scope: Scope) -> str:
    type_ = cpp_type(member.type)
    if member.initial is not None:
        return f"initial<{type_}>({scope.expression(member.initial)})"
    inner = member.type
    while isinstance(inner, Array):
        inner = inner.of
    held = scope.declared.get(inner.name) if isinstance(inner, Named) else None
    if isinstance(held, Enumeration):
        if inner is not member.type:
            raise Unsupported(f"{member.name}: an array of an enumeration")
        return f"{type_}::{variable(held.initial)}"
    return f"{type_}{{}}"


# --- code ---------------------------------------------------------------------------------------------


def _definitions(block: Block, names: Mapping[str, Declaration]) -> Iterator[str]:
    owner = type_name(block.name)
    where = block.name
    try:
        yield f"void {owner}::body() {{\n{statements(Scope(names, block), block.body)}\n}}"
        for method in block.methods.values():
            where = f"{block.name}.{method.name}"
            scope = Scope(names, block, method)
            name = method_name(method.name)
            yield f"void {owner}::{name}([[maybe_unused]] {name}_parameters &p) {{"
            for one in _parameters(method):
                yield f"    [[maybe_unused]] auto &{variable(one.name)} = p.{variable(one.name)};"
            yield from (f"    {_member(one, scope)}" for one in method.variables if one.section == "local")
            yield f"{statements(scope, method.body)}\n}}"
    except Unsupported as error:
        raise Unsupported(f"{where}: {error}") from None


# --- what Python sees ---------------------------------------------------------------------------------


def _owners(names: Iterable[Declaration]) -> Iterator[tuple[str, tuple[Variable, ...]]]:
    """All that has members at offsets."""
    for one in names:
        match one:
            case Structure(members=variables) | Globals(variables=variables):
                yield one.name, variables
            case Block():
                yield one.name, tuple(member for member in one.variables if member.section != "constant")
                for method in one.methods.values():
                    yield f"{one.name}.{method.name}", _parameters(method)
            case Enumeration():
                pass


def _tables(unit: int, names: list[Declaration]) -> str:
    members, kinds, entries = [], [], []
    for one in names:
        type_ = type_name(one.name)
        if isinstance(one, Enumeration):
            members += [f'{{"{one.name}", "{name}", (uint64_t){type_}::{variable(name)}, 0}}' for name, _ in one.values]
        for owner, variables in _owners([one]):
            method = owner.partition(".")[2]
            kind = f"{type_}::{method_name(method)}_parameters" if method else type_
            place = f"(void *)&{variable(owner)}" if isinstance(one, Globals) else "nullptr"
            kinds.append(f'{{"{owner}", sizeof({kind}), make<{kind}>, {place}}}')
            if isinstance(one, Block):
                call = f"{method_name(method)}(*({kind} *)given)" if method else "body()"
                guarded = f"guarded([&] {{ (void)given; (({type_} *)self)->{call}; }})"
                entries.append(f'{{"{one.name}", "{method}", [](void *self, void *given) {{ return {guarded}; }}}}')
            for member in variables:
                name = variable(member.name)
                size = f"sizeof((({kind} *)nullptr)->{name})"
                members.append(f'{{"{owner}", "{member.name}", offsetof({kind}, {name}), {size}}}')
    return "\n".join(
        f'extern "C" {{ extern const {row} {table}_{unit}[]; const {row} {table}_{unit}[] = {{\n{text}\n}}; }}'
        for row, table, rows in (
            ("Member", "members", members),
            ("Kind", "kinds", kinds),
            ("Entry", "entries", entries),
        )
        for text in [",\n".join([*rows, "{}"])]
    )
