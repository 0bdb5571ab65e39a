"""Translates blark's expressions and calls to C++ on top of runtime.hpp.

Names stay recognisable: `xEnable` becomes `v_xenable`, a type `T_...`, a method `m_...`. No user's name can collide
with a keyword of C++. C++ resolves the names, because its scopes (method, block, qualified lists) match those of
Structured Text. Only the target of a call is looked up here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from blark import transform as b

from tests.softplc.declarations import Block, Declaration, Enumeration, Globals, Method, Structure, Variable
from tests.softplc.iec import ELEMENTARY, Array, Elementary, Named, Pointer, Text, Type
from tests.softplc.literals import literal
from tests.softplc.reading import Unsupported

_OPERATORS = {
    "+": "add", "-": "subtract", "*": "multiply", "/": "divide", "MOD": "modulo",
    "=": "equal", "<>": "unequal", "<": "less", ">": "greater", "<=": "at_most", ">=": "at_least",
    "AND": "both", "&": "both", "OR": "either", "XOR": "differ",
}  # fmt: skip
_FUNCTIONS = {
    name.upper()
    for name in (
        "SysSharedMemoryOpen2", "SysSharedMemoryCreate", "SysSharedMemoryGetPointer", "SysSharedMemoryClose",
        "SysSemProcessCreate", "SysSemProcessEnter", "SysSemProcessLeave", "SysSemProcessDelete",
    )
}  # fmt: skip
_CONVERSION = re.compile(rf"({'|'.join(ELEMENTARY)})_TO_({'|'.join(ELEMENTARY)})")


def variable(name: str) -> str:
    return f"v_{name.lower()}"


def type_name(name: str) -> str:
    return f"T_{name.lower()}"


def method_name(name: str) -> str:
    return f"m_{name.lower()}"


def cpp_type(type_: Type) -> str:
    match type_:
        case Elementary(name):
            return name
        case Text(length, wide):
            return f"WSTRING<{length}>" if wide else f"STRING<{length}>"
        case Named(name):
            return type_name(name)
        case Pointer(to):
            return f"Pointer<{cpp_type(to)}>"
        case Array(first, last, of):
            return f"Array<{first}, {last}, {cpp_type(of)}>"


@dataclass(frozen=True)
class Scope:
    """The place of a statement. `method` is None in a block's body, and `block` is None among declarations."""

    declared: Mapping[str, Declaration]
    block: Block | None = None
    method: Method | None = None

    # --- expressions ----------------------------------------------------------------------------------

    def expression(self, tree: Any) -> str:
        match tree:
            case b.Literal():
                return literal(tree)
            case b.SimpleVariable() | b.MultiElementVariable():
                return self.path(tree)
            case b.ParenthesizedExpression():
                return self.expression(tree.expr)
            case b.UnaryOperation():
                function = {"NOT": "inverse", "-": "negative"}.get(str(tree.op).upper())
                if function is None:
                    raise Unsupported(f"the operator {tree.op}")
                return f"{function}({self.expression(tree.expr)})"
            case b.BinaryOperation():
                return self.binary(tree)
            case b.FunctionCall():
                return self.call(tree, as_statement=False)
            case _:
                raise Unsupported(type(tree).__name__)

    def binary(self, tree: b.BinaryOperation) -> str:
        left, right, operator = self.expression(tree.left), self.expression(tree.right), str(tree.op).upper()
        if operator in ("AND_THEN", "OR_ELSE"):
            return f"BOOL(truth({left}) {'&&' if operator == 'AND_THEN' else '||'} truth({right}))"
        if operator not in _OPERATORS:
            raise Unsupported(f"the operator {operator}")
        if self.has_effects(tree.left) and self.has_effects(tree.right):
            raise Unsupported(f"calls on both sides of {operator}: their order is not ours to choose")
        return f"{_OPERATORS[operator]}({left}, {right})"

    def path(self, tree: Any) -> str:
        """Translate a variable with its members, elements and dereferences, or a value of an enumeration."""
        match tree:
            case b.SimpleVariable():
                name = str(tree.name).upper()
                if name in ("THIS", "SUPER"):
                    raise Unsupported(name)
                return f"(*{variable(name)})" if tree.dereferenced else variable(name)
            case b.MultiElementVariable():
                first = str(tree.name.name).upper() if isinstance(tree.name, b.SimpleVariable) else ""
                if isinstance(self.declared.get(first), Enumeration) and len(tree.elements) == 1:
                    return f"{type_name(first)}::{variable(str(tree.elements[0].field.name))}"
                spelled = self.path(tree.name)
                for element in tree.elements:
                    if isinstance(element, b.FieldSelector):
                        # blark stores the ^ of `a^.b` either in `a` or in `.b` as a whole.
                        base = f"(*{spelled})" if element.dereferenced else spelled
                        spelled = f"{base}.{variable(str(element.field.name))}"
                        pointer = element.field.dereferenced
                    else:
                        for index in element.subscripts:
                            spelled = f"element({spelled}, {self.expression(index)})"
                        pointer = element.dereferenced
                    spelled = f"(*{spelled})" if pointer else spelled
                return spelled
            case _:
                raise Unsupported(type(tree).__name__)

    # --- calls ----------------------------------------------------------------------------------------

    def call(self, tree: Any, as_statement: bool) -> str:
        name, arguments = tree.name, list(tree.parameters or ())
        if isinstance(name, b.SimpleVariable):
            plain = str(name.name).upper()
            if self.block is not None and plain in self.block.methods:
                return self.method_call("*this", self.block, self.block.methods[plain], arguments)
            if (called := self.block_of(self.type_of(name))) is None:
                return self.function(plain, arguments)
        else:
            *_, last = name.elements
            owner = self.block_of(self.type_of(name, but_last=True))
            if owner is not None and isinstance(last, b.FieldSelector) and not last.field.dereferenced:
                method = owner.methods.get(str(last.field.name).upper())
                if method is not None:
                    return self.method_call(self.receiver(name), owner, method, arguments)
            if (called := self.block_of(self.type_of(name))) is None:
                raise Unsupported(f"the call of {name}")
        if not as_statement:
            raise Unsupported(f"the block {name} called within an expression")
        return self.block_call(self.path(name), called, arguments)

    def function(self, name: str, arguments: list[Any]) -> str:
        values = [parameter.value for parameter in arguments]
        if any(parameter.name for parameter in arguments) or sum(map(self.has_effects, values)) > 1:
            raise Unsupported(f"parameters by name, or calls in several of them, in {name}")
        if name == "SIZEOF" and len(values) == 1:
            plain = str(values[0].name).upper() if isinstance(values[0], b.SimpleVariable) else ""
            what = type_name(plain) if plain in self.declared else self.expression(values[0])
            return f"Integer<sizeof({what})>{{}}"
        spelled = ", ".join(map(self.expression, values))
        if name == "TIME" and not values:
            return "IEC_TIME()"
        if conversion := _CONVERSION.fullmatch(name):
            if len(values) != 1:
                raise Unsupported(f"{name} of {len(values)} values")
            return f"convert<{conversion[2]}>(as_argument<{conversion[1]}>({spelled}))"
        if name == "ADR" or name in _FUNCTIONS:
            return f"{name}({spelled})"
        raise Unsupported(f"the function {name}")

    def method_call(self, receiver: str, owner: Block, method: Method, arguments: list[Any]) -> str:
        """Return `[&]{ parameters; call; outputs }()`. A lambda can be part of an expression."""
        if method.private and receiver != "*this":
            raise Unsupported(f"the PRIVATE method {method.name} called from outside of {owner.name}")
        parameters = f"{type_name(owner.name)}::{method_name(method.name)}_parameters"
        inputs, outputs = self.split(method.name, method.parameters, arguments)
        for parameter in method.parameters:
            if parameter.section == "input" and parameter.initial is None and parameter.name not in inputs:
                raise Unsupported(f"{method.name} called without {parameter.name}")
        steps = [f"auto &self = {receiver};", f"{parameters} p;"]
        steps += [f"set(p.{variable(name)}, {self.expression(value)});" for name, value in inputs.items()]
        steps.append(f"self.{method_name(method.name)}(p);")
        steps += [f"set({self.path(value)}, p.{variable(name)});" for name, value in outputs.items()]
        if method.result is not None:
            steps.append(f"return p.{variable(method.name)};")
        return f"[&] {{ {' '.join(steps)} }}()"

    def block_call(self, receiver: str, called: Block, arguments: list[Any]) -> str:
        inputs, outputs = self.split(called.name, called.variables, arguments)
        steps = [f"auto &self = {receiver};"]
        steps += [f"set(self.{variable(name)}, {self.expression(value)});" for name, value in inputs.items()]
        steps.append("self.body();")
        steps += [f"set({self.path(value)}, self.{variable(name)});" for name, value in outputs.items()]
        return f"{{ {' '.join(steps)} }}"

    def split(self, called: str, known: Iterable[Variable], trees: list[Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the values of the inputs and of the outputs, each by name."""
        sections = {one.name: one.section for one in known}
        values: dict[str, dict[str, Any]] = {"input": {}, "output": {}}
        for parameter in trees:
            section = "output" if isinstance(parameter, b.OutputParameterAssignment) else "input"
            if parameter.name is None:
                raise Unsupported(f"a parameter without a name in the call of {called}")
            name = str(getattr(parameter.name, "name", parameter.name)).upper()
            if sections.get(name) != section or getattr(parameter, "inverted", False):
                raise Unsupported(f"{name} as {section} of {called}")
            values[section][name] = parameter.value
        return values["input"], values["output"]

    def receiver(self, name: b.MultiElementVariable) -> str:
        if len(name.elements) == 1:
            return self.path(name.name)
        return self.path(b.MultiElementVariable(name=name.name, dereferenced=False, elements=name.elements[:-1]))

    def block_of(self, type_: Type | None) -> Block | None:
        owner = self.declared.get(type_.name) if isinstance(type_, Named) else None
        return owner if isinstance(owner, Block) else None

    def type_of(self, tree: Any, but_last: bool = False) -> Type | None:
        """Return the type of a path such as `a.b[i].c`, or None for anything else. Calls need the type."""
        if isinstance(tree, b.SimpleVariable):
            return None if tree.dereferenced else self.declared_type(str(tree.name).upper())
        elements = tree.elements[:-1] if but_last else tree.elements
        if not isinstance(tree.name, b.SimpleVariable) or tree.name.dereferenced:
            return None
        members = self.members(str(tree.name.name).upper())
        type_ = self.declared_type(str(tree.name.name).upper())
        for element in elements:
            if isinstance(element, b.SubscriptList) and isinstance(type_, Array) and not element.dereferenced:
                type_ = type_.of
                continue
            if not isinstance(element, b.FieldSelector) or element.dereferenced or element.field.dereferenced:
                return None
            if type_ is not None:
                members = self.members(type_.name) if isinstance(type_, Named) else {}
            type_ = members.get(str(element.field.name).upper())
        return type_

    def declared_type(self, name: str) -> Type | None:
        for owner in (self.method, self.block):
            for one in owner.variables if owner else ():
                if one.name == name:
                    return one.type
        return None

    def members(self, name: str) -> dict[str, Type]:
        match self.declared.get(name):
            case Structure(members=variables) | Globals(variables=variables) | Block(variables=variables):
                return {one.name: one.type for one in variables}
        return {}

    def has_effects(self, tree: Any) -> bool:
        """Return True if the expression contains a call that may change a variable."""
        match tree:
            case b.FunctionCall(name=b.SimpleVariable(name=name), parameters=arguments):
                plain = str(name).upper()
                pure = plain in ("SIZEOF", "ADR", "TIME") or _CONVERSION.fullmatch(plain) is not None
                return not pure or any(self.has_effects(parameter.value) for parameter in arguments or ())
            case b.FunctionCall():
                return True
            case b.BinaryOperation(left=left, right=right):
                return self.has_effects(left) or self.has_effects(right)
            case b.UnaryOperation(expr=inner) | b.ParenthesizedExpression(expr=inner):
                return self.has_effects(inner)
        return False
