"""Generate all mutants of a module: one operator, number or condition changed, or one statement removed."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
COUNTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Add,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Add,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}


class Mutant(NamedTuple):
    """A change of a module: the bytes `start` to `end` of `file`, on lines `line` to `last`, become `now`.

    `where` is the function, `was` the replaced text.
    """

    file: str
    line: int
    last: int
    start: int
    end: int
    where: str
    was: str
    now: str

    @property
    def key(self) -> tuple[str, str, str, str]:
        """Return a key that does not change if other lines change."""
        return self.file, self.where, self.was, self.now

    def apply(self, text: bytes) -> bytes:
        return text[: self.start] + self.now.partition("  # ")[0].encode() + text[self.end :]

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.where}\n  - {self.was}\n  + {self.now}"


def mutants_of(file: str, text: bytes) -> list[Mutant]:
    """Return all mutants of a file. Equal changes in one function are numbered `# 2`, `# 3`."""
    lines = [0]
    for line in text.splitlines(keepends=True):
        lines.append(lines[-1] + len(line))
    mutants: list[Mutant] = []
    seen: Counter[tuple[str, str, str, str]] = Counter()
    for node, where, now in _changes(ast.parse(text), ""):
        start = lines[node.lineno - 1] + node.col_offset
        end = lines[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        was = " ".join(text[start:end].decode().split())
        mutant = Mutant(file, node.lineno, node.end_lineno or 0, start, end, where, was, now)
        seen[mutant.key] += 1
        again = seen[mutant.key]
        mutants.append(mutant if again == 1 else mutant._replace(now=f"{now}  # {again}"))
    return mutants


def _changes(node: ast.AST, where: str) -> Iterator[tuple[ast.expr | ast.stmt, str, str]]:
    """Yield each changed node, its function and its replacement."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        where = f"{where}.{node.name}" if where else node.name
    if isinstance(node, ast.expr):
        yield from ((node, where, f"({ast.unparse(changed)})") for changed in _expressions(node))
    elif isinstance(node, ast.stmt):
        yield from ((node, where, now) for now in _statements(node))
    for name, value in ast.iter_fields(node):
        if not _is_left_out(node, name):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _changes(child, where)


def _is_left_out(node: ast.AST, field: str) -> bool:
    """Return True for types, asserts, and f-strings, whose positions are wrong before Python 3.12."""
    if isinstance(node, ast.JoinedStr | ast.Assert) or field in ("annotation", "returns", "decorator_list", "bases"):
        return True
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def _expressions(node: ast.expr) -> Iterator[ast.expr]:
    match node:
        case ast.Compare(left, operators, others):
            for place, operator in enumerate(operators):
                changed = [*operators[:place], COMPARED[type(operator)](), *operators[place + 1 :]]
                yield ast.Compare(left, changed, others)
        case ast.BinOp(left, operator, right) if type(operator) in COUNTED:
            yield ast.BinOp(left, COUNTED[type(operator)](), right)
        case ast.BoolOp(operator, values):
            yield ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), values)
        case ast.UnaryOp(ast.Not(), operand):
            yield operand
        case ast.Constant(bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(int() | float() as value):
            yield ast.Constant(value + 1)
        case ast.IfExp(test, body, other):
            yield ast.IfExp(ast.UnaryOp(ast.Not(), test), body, other)


def _statements(node: ast.stmt) -> Iterator[str]:
    match node:
        case ast.Expr(ast.Call(ast.Name("assert_never"))):
            return  # mypy proves that nobody comes there
        case ast.Expr(ast.Call() | ast.YieldFrom()) | ast.AugAssign() | ast.Raise() | ast.Delete() | ast.Break():
            yield "pass"
        case ast.Assign([ast.Attribute() | ast.Subscript(), *_]) | ast.AnnAssign(ast.Attribute(), _, ast.expr()):
            yield "pass"
        case ast.Continue():
            yield "break"
        case ast.Return(ast.expr() as value) if not (isinstance(value, ast.Constant) and value.value is None):
            yield "return None"
