"""Translates blark's statements to C++."""

from __future__ import annotations

from functools import partial
from typing import Any

from blark import transform as b

from tests.softplc.declarations import Enumeration
from tests.softplc.expressions import Scope, type_name, variable
from tests.softplc.reading import Unsupported


def statements(scope: Scope, tree: Any) -> str:
    return "\n".join(map(partial(statement, scope), tree.statements or ())) if tree is not None else ""


def statement(scope: Scope, tree: Any) -> str:
    match tree:
        case b.AssignmentStatement(variables=[target]):
            return f"set({scope.path(target)}, {scope.expression(tree.expression)});"
        case b.FunctionCallStatement():
            return f"{scope.call(tree, as_statement=True)};"
        case b.IfStatement():
            return if_(scope, tree)
        case b.CaseStatement():
            return case(scope, tree)
        case b.ForStatement(step=None):
            control, last = scope.path(tree.control), scope.expression(tree.to)
            if scope.has_effects(tree.to):
                raise Unsupported("a call as the end of FOR")
            head = f"set({control}, {scope.expression(tree.from_)}); truth(at_most({control}, {last}));"
            return f"for ({head} set({control}, add({control}, Integer<1>{{}}))) {braced(scope, tree.statements)}"
        case b.WhileStatement():
            return f"while (truth({scope.expression(tree.expression)})) {braced(scope, tree.statements)}"
        case b.NoOpStatement():
            return ""
        case b.ReturnStatement():
            return "return;"
        case b.ExitStatement():
            return "break;"
        case b.ContinueStatement():
            return "continue;"
        case b.ForStatement():
            raise Unsupported("FOR with BY")
        case _:
            raise Unsupported(type(tree).__name__)


def braced(scope: Scope, tree: Any) -> str:
    return f"{{\n{statements(scope, tree)}\n}}"


def if_(scope: Scope, tree: b.IfStatement) -> str:
    text = f"if (truth({scope.expression(tree.if_expression)})) {braced(scope, tree.statements)}"
    for clause in tree.else_ifs or ():
        text += f" else if (truth({scope.expression(clause.if_expression)})) {braced(scope, clause.statements)}"
    return text + (f" else {braced(scope, tree.else_clause.statements)}" if tree.else_clause else "")


def case(scope: Scope, tree: b.CaseStatement) -> str:
    """Translate CASE to a chain of ifs, in which EXIT still ends the enclosing loop."""
    text = ""
    for element in tree.cases:
        matches = " || ".join(map(partial(label, scope), element.matches))
        text += f"if ({matches}) {braced(scope, element.statements)} else "
    rest = braced(scope, tree.else_clause.statements) if tree.else_clause else "{}"
    return f"{{\nconst auto selector = {scope.expression(tree.expression)};\n{text}{rest}\n}}"


def label(scope: Scope, tree: Any) -> str:
    match tree:
        case b.PartialSubrange():
            first, last = scope.expression(tree.start), scope.expression(tree.stop)
            return f"(truth(at_least(selector, {first})) && truth(at_most(selector, {last})))"
        case b.EnumeratedValue(name=name, value=None):
            type_, dot, value = str(name).upper().partition(".")
            if dot and not isinstance(scope.declared.get(type_), Enumeration):
                raise Unsupported(f"the label {name}")
            spelled = f"{type_name(type_)}::{variable(value)}" if dot else variable(type_)
            return f"truth(equal(selector, {spelled}))"
        case _:
            return f"truth(equal(selector, {scope.expression(tree)}))"
