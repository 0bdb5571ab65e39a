"""Translates a declaration to C++: a type, the code of a block, and table rows that describe the members for Python."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from tests.softplc.declarations import Block, Declaration, Enumeration, Globals, Method, Structure, Variable
from tests.softplc.expressions import Scope, cpp_type, method_name, type_name, variable
from tests.softplc.iec import Array, Named
from tests.softplc.reading import Unsupported
from tests.softplc.statements import statements


def declaration(one: Declaration, names: Mapping[str, Declaration]) -> Iterator[str]:
    scope = Scope(names)
    match one:
        case Enumeration():
            spelled = ", ".join(
                variable(name)
                if value is None
                else f"{variable(name)} = as<{one.base.name}>({scope.expression(value)})"
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
                yield f"    {_variable(member, scope)}"
            for method in one.methods.values():
                parameters = f"{method_name(method.name)}_parameters"
                yield f"    struct {parameters} {{"
                yield from (f"        {_variable(member, scope)}" for member in _parameters(method))
                yield "    };"
                yield f"    void {method_name(method.name)}({parameters} &p);"
            yield "    void body();"
            yield "};"
        case Globals():
            yield f"struct {type_name(one.name)} {{"
            yield from (f"    {_variable(member, scope)}" for member in one.variables)
            yield "};"
            yield f"inline {'const ' * one.constant}{type_name(one.name)} {variable(one.name)}{{}};"


def definitions(block: Block, names: Mapping[str, Declaration]) -> Iterator[str]:
    owner = type_name(block.name)
    place = block.name
    try:
        yield f"void {owner}::body() {{\n{statements(Scope(names, block), block.body)}\n}}"
        for method in block.methods.values():
            place = f"{block.name}.{method.name}"
            scope = Scope(names, block, method)
            name = method_name(method.name)
            yield f"void {owner}::{name}([[maybe_unused]] {name}_parameters &p) {{"
            for one in _parameters(method):
                yield f"    [[maybe_unused]] auto &{variable(one.name)} = p.{variable(one.name)};"
            yield from (f"    {_variable(one, scope)}" for one in method.variables if one.section == "local")
            yield f"{statements(scope, method.body)}\n}}"
    except Unsupported as error:
        raise Unsupported(f"{place}: {error}") from None


def owners(names: Iterable[Declaration]) -> Iterator[tuple[str, tuple[Variable, ...]]]:
    """Yield each owner of members, and these members. A method's parameters belong to `BLOCK.METHOD`."""
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


class Rows(NamedTuple):
    """Rows of the tables that Python reads. See the end of runtime.hpp."""

    members: list[str]
    kinds: list[str]
    entries: list[str]


def rows(one: Declaration) -> Rows:
    """Return the table rows that describe a compiled declaration."""
    members, kinds, entries = tables = Rows([], [], [])
    type_ = type_name(one.name)
    if isinstance(one, Enumeration):
        members += [f'{{"{one.name}", "{name}", (uint64_t){type_}::{variable(name)}, 0}}' for name, _ in one.values]
    for owner, variables in owners([one]):
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
    return tables


def _parameters(method: Method) -> tuple[Variable, ...]:
    result = () if method.result is None else (Variable(method.name, method.result, "output", None),)
    return (*method.parameters, *result)


def _variable(one: Variable, scope: Scope) -> str:
    """Return a declaration. Structures are aligned to 8 bytes: a 32-bit ARM cannot read 64 bits elsewhere (SIGBUS)."""
    return f"alignas(8) {_member(one, scope)}" if isinstance(one.type, (Named, Array)) else _member(one, scope)


def _member(member: Variable, scope: Scope) -> str:
    type_, name = cpp_type(member.type), variable(member.name)
    if member.section == "constant":
        return f"static inline const {type_} {name} = {_initial(member, scope)};"
    return f"{type_} {name} = {_initial(member, scope)};"


def _initial(member: Variable, scope: Scope) -> str:
    type_ = cpp_type(member.type)
    if isinstance(member.initial, list):
        values = ", ".join(map(scope.expression, member.initial))
        return f"initial_array<{type_}>({values})"
    if member.initial is not None:
        return f"initial<{type_}>({scope.expression(member.initial)})"
    inner = member.type
    while isinstance(inner, Array):
        inner = inner.of
    enumeration = scope.declared.get(inner.name) if isinstance(inner, Named) else None
    if isinstance(enumeration, Enumeration):
        if inner is not member.type:
            raise Unsupported(f"{member.name}: an array of an enumeration")
        return f"{type_}::{variable(enumeration.initial)}"
    return f"{type_}{{}}"
