"""Evaluate the integer expressions of bounds and enumerations with the constants of the project."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, TypeVar

from shmgen.core.diagnostics import Span
from shmgen.plc.declarations import Declaration

T = TypeVar("T")


class NotConvertible(Exception):
    """A data type cannot be a message, because ROS or the project has no equivalent of a type, a name or a number.

    The attributes become a diagnostic.
    """

    def __init__(self, message: str, hint: str, code: str = "SHM601", details: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.message, self.hint, self.code, self.details = message, hint, code, details


class Constant(NamedTuple):
    """A constant. `owner` is the list or enumeration that contains the constant, or `""` if not known."""

    owner: str
    name: str
    value: str
    span: Span


_TERM = re.compile(
    r"(?:[^\W\d]\w*#)?(?:(?P<base>\d+)#(?P<digits>[0-9A-Fa-f_]+)|(?P<number>\d[\d_]*))"
    r"|(?P<name>[^\W\d]\w*(?:[.#][^\W\d]\w*)*)|(?P<sign>[-+*/()])|(?P<blank>\s+)|(?P<other>.)",
    re.DOTALL,
)
_BINDS = {"+": 1, "-": 1, "*": 2, "/": 2, "MOD": 2}
_DEEPEST = 32
"""The limit of nested brackets, and of constants that refer to other constants."""
_LONGEST = 2_000
"""The longest expression in characters."""
_LARGEST = 2**64


class Numbers:
    """Computes the values of expressions, with the constants and enumerations of a project.

    An expression refers to a constant by its name, or by `List.Name`.
    """

    def __init__(self, constants: Iterable[Constant], types: Iterable[Declaration]) -> None:
        self._enumerations = {it.name.upper(): it for it in types if it.kind == "enum"}
        named = (Constant(one.name, it.name, "", it.span) for one in self._enumerations.values() for it in one.members)
        self._constants: dict[str, list[Constant]] = {}
        for constant in (*constants, *named):
            self._constants.setdefault(constant.name.upper(), []).append(constant)
        self._values: dict[str, int | Exception] = {}
        self._counted: dict[str, dict[str, int] | Exception] = {}
        self._open: list[str] = []

    def value(self, text: str) -> int:
        """Return the value of an expression such as `16#FF`, `GVL.MAX_AXES - 1` or `E_Mode.Last`.

        Raises NotConvertible (SHM602 or SHM301) if the value cannot be computed.
        """
        return self._in(text, {})

    def of(self, declared: Declaration) -> dict[str, int]:
        """Return the value of each name of an enumeration, in order.

        Raises NotConvertible if a value cannot be computed.
        """
        key = declared.name.upper()
        if key not in self._counted:
            self._counted[key] = _unknown(declared.name)  # the result while this call runs, to stop recursion
            try:
                self._counted[key] = self._count(declared)
            except NotConvertible as error:
                self._counted[key] = error
        return _or_raise(self._counted[key])

    def _count(self, declared: Declaration) -> dict[str, int]:
        known: dict[str, int] = {}
        value = -1
        for member in declared.members:
            value = self._in(member.value, known) if member.value else value + 1
            known[member.name.upper()] = value
        return known

    def _in(self, text: str, known: Mapping[str, int]) -> int:
        try:
            if len(text) > _LONGEST:
                raise ValueError
            terms = deque(_terms(text))
            value = self._sum(terms, known, 0, 0)
            if terms or abs(value) > _LARGEST:
                raise ValueError
        except (IndexError, ValueError, ZeroDivisionError):
            raise _unknown(text) from None
        return value

    def _sum(self, terms: deque[str | int], known: Mapping[str, int], binds: int, depth: int) -> int:
        """Evaluate the expression at the beginning of `terms`, and remove its terms.

        The expression ends before an operator whose precedence is not above `binds`. Raises IndexError, ValueError or
        ZeroDivisionError if the expression is invalid.
        """
        term = terms.popleft()
        if depth > _DEEPEST:
            raise ValueError
        if term == "(":
            value = self._sum(terms, known, 0, depth + 1)
            if terms.popleft() != ")":
                raise ValueError
        elif term in ("+", "-"):
            value = self._sum(terms, known, 2, depth + 1) * (-1 if term == "-" else 1)
        else:
            value = term if isinstance(term, int) else self._evaluate_name(term, known)
        while terms and (stronger := _BINDS.get(str(terms[0]), 0)) > binds:
            value = _calculate(value, str(terms.popleft()), self._sum(terms, known, stronger, depth + 1))
        return value

    def _evaluate_name(self, name: str, known: Mapping[str, int]) -> int:
        if name in known:
            return known[name]
        if name in self._open or len(self._open) > _DEEPEST:
            raise NotConvertible(
                f"`{name}` refers to itself, or to too many other constants", "give it a number", "SHM301"
            )
        if name not in self._values:
            self._open.append(name)
            try:
                self._values[name] = self._only(name, self._candidates(name))
            except (NotConvertible, ValueError) as error:
                self._values[name] = error
            self._open.pop()
        return _or_raise(self._values[name])

    def _candidates(self, name: str) -> list[Constant]:
        """Return the constants that a name may refer to.

        For a name such as `Namespace.List.Name`, these are the constants of `List`, and constants whose list is not
        known.
        """
        *owners, bare = re.split("[.#]", name)
        candidates = self._constants.get(bare, [])
        return [it for it in candidates if it.owner.upper() in ("", owners[-1])] if owners else candidates

    def _only(self, name: str, candidates: list[Constant]) -> int:
        values: dict[int, Constant] = {}
        for constant in candidates:
            enumeration = "" if constant.value else constant.owner.upper()
            value = self.of(self._enumerations[enumeration])[constant.name.upper()] if enumeration else None
            values.setdefault(self.value(constant.value) if value is None else value, constant)
        if len(values) > 1:
            places = " and ".join(f"{value} in {it.span.path}:{it.span.line}" for value, it in list(values.items())[:2])
            raise NotConvertible(
                f"`{name}` is {places}", "write the name of its list before it, as in GVL.NAME", "SHM602"
            )
        if not values:
            raise ValueError(name)
        return next(iter(values))


def _or_raise(result: T | Exception) -> T:
    """Return a remembered result, or raise the remembered exception."""
    if isinstance(result, Exception):
        raise result
    return result


def _terms(text: str) -> Iterator[str | int]:
    """Split an expression into its terms: numbers, names in capital letters, and signs.

    Raises ValueError if a character is invalid.
    """
    for match in _TERM.finditer(text):
        if match["base"]:
            yield int(match["digits"].replace("_", ""), int(match["base"]))
        elif match["number"]:
            yield int(match["number"].replace("_", ""))
        elif match["other"]:
            raise ValueError(text)
        elif not match["blank"]:
            yield match[0].upper()


def _calculate(one: int, sign: str, other: int) -> int:
    """Calculate as Structured Text does, with division towards zero.

    Raises ValueError if the result is too large, and ZeroDivisionError if the divisor is 0.
    """
    if sign in ("/", "MOD"):
        whole = abs(one) // abs(other) * (1 if (one < 0) == (other < 0) else -1)
        value = whole if sign == "/" else one - whole * other
    else:
        value = {"+": one + other, "-": one - other, "*": one * other}[sign]
    if abs(value) > _LARGEST:
        raise ValueError
    return value


def _unknown(text: str) -> NotConvertible:
    excerpt = text if len(text) <= 80 else f"{text[:80]}…"
    return NotConvertible(
        f"`{excerpt}` is not declared", "also import the list of constants that declares it", "SHM602"
    )
