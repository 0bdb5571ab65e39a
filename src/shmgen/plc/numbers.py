"""Works out the whole numbers that bounds and enumerations are spelled with, by the constants of the project."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple, TypeVar

from shmgen.core.diagnostics import Span
from shmgen.plc.declarations import Declared

T = TypeVar("T")


class Nothing(Exception):
    """ROS, or the project, has nothing for it; `code` is that of the diagnostic."""

    def __init__(self, message: str, hint: str, code: str = "SHM601") -> None:
        super().__init__(message)
        self.message, self.hint, self.code = message, hint, code


class Constant(NamedTuple):
    """`owner` is the list or the enumeration that it stands in, empty where that is not said."""

    owner: str
    name: str
    value: str
    span: Span


_TERM = re.compile(
    r"(?:[A-Za-z_]\w*#)?(?:(?P<base>\d+)#(?P<digits>[0-9A-Fa-f_]+)|(?P<number>\d[\d_]*))"
    r"|(?P<name>[A-Za-z_]\w*(?:[.#][A-Za-z_]\w*)*)|(?P<sign>[-+*/()])|(?P<blank>\s+)|(?P<other>.)",
    re.DOTALL,
)
_BINDS = {"+": 1, "-": 1, "*": 2, "/": 2, "MOD": 2}
_DEEPEST = 32
"""Brackets in each other, and constants that name constants."""
_LONGEST = 2_000
"""Characters of a sum."""
_LARGEST = 2**64


class Numbers:
    """The constants and the names of enumerations of a project, each found by its name and by `List.Name`."""

    def __init__(self, constants: Iterable[Constant], types: Iterable[Declared]) -> None:
        self._enumerations = {it.name.upper(): it for it in types if it.kind == "enum"}
        named = (Constant(one.name, it.name, "", it.span) for one in self._enumerations.values() for it in one.members)
        self._found: dict[str, list[Constant]] = {}
        for constant in (*constants, *named):
            self._found.setdefault(constant.name.upper(), []).append(constant)
        self._values: dict[str, int | Exception] = {}
        self._counted: dict[str, dict[str, int] | Exception] = {}
        self._open: list[str] = []

    def value(self, text: str) -> int:
        """Of `10`, `16#FF`, `MAX_AXES`, `GVL.MAX_AXES - 1`, `E_Mode.Last`. Raises Nothing: SHM602."""
        return self._in(text, {})

    def of(self, declared: Declared) -> dict[str, int]:
        """What the names of an enumeration stand for, in their order. Raises Nothing."""
        key = declared.name.upper()
        if key not in self._counted:
            self._counted[key] = _unknown(declared.name)  # while it is open, and where it cannot be counted
            try:
                self._counted[key] = self._count(declared)
            except Nothing as nothing:
                self._counted[key] = nothing
        return _or_raise(self._counted[key])

    def _count(self, declared: Declared) -> dict[str, int]:
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
        """Up to a sign that binds no stronger than `binds`. Raises IndexError, ValueError and ZeroDivisionError."""
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
            value = term if isinstance(term, int) else self._named(term, known)
        while terms and (stronger := _BINDS.get(str(terms[0]), 0)) > binds:
            value = _reckoned(value, str(terms.popleft()), self._sum(terms, known, stronger, depth + 1))
        return value

    def _named(self, name: str, known: Mapping[str, int]) -> int:
        if name in known:
            return known[name]
        if name in self._open or len(self._open) > _DEEPEST:
            raise Nothing(f"`{name}` is made of itself, or of too many others", "give it a number", "SHM301")
        if name not in self._values:
            self._open.append(name)
            try:
                self._values[name] = self._only(name, self._candidates(name))
            except (Nothing, ValueError) as error:
                self._values[name] = error
            self._open.pop()
        return _or_raise(self._values[name])

    def _candidates(self, name: str) -> list[Constant]:
        """Those of the list that is named; `Namespace.List.Name` has the list's last."""
        *owners, bare = re.split("[.#]", name)
        found = self._found.get(bare, [])
        return [it for it in found if it.owner.upper() in ("", owners[-1])] if owners else found

    def _only(self, name: str, found: list[Constant]) -> int:
        values: dict[int, Constant] = {}
        for constant in found:
            enumeration = "" if constant.value else constant.owner.upper()
            value = self.of(self._enumerations[enumeration])[constant.name.upper()] if enumeration else None
            values.setdefault(self.value(constant.value) if value is None else value, constant)
        if len(values) > 1:
            places = " and ".join(f"{value} in {it.span.path}:{it.span.line}" for value, it in list(values.items())[:2])
            raise Nothing(f"`{name}` is {places}", "write the name of its list before it", "SHM602")
        if not values:
            raise ValueError(name)
        return next(iter(values))


def _or_raise(found: T | Exception) -> T:
    """What was found before, or why it was not."""
    if isinstance(found, Exception):
        raise found
    return found


def _terms(text: str) -> Iterator[str | int]:
    """Numbers, names in capital letters, signs. Raises ValueError."""
    for found in _TERM.finditer(text):
        if found["base"]:
            yield int(found["digits"].replace("_", ""), int(found["base"]))
        elif found["number"]:
            yield int(found["number"].replace("_", ""))
        elif found["other"]:
            raise ValueError(text)
        elif not found["blank"]:
            yield found[0].upper()


def _reckoned(one: int, sign: str, other: int) -> int:
    """As Structured Text does, which divides towards zero. Raises ValueError and ZeroDivisionError."""
    if sign in ("/", "MOD"):
        whole = abs(one) // abs(other) * (1 if (one < 0) == (other < 0) else -1)
        value = whole if sign == "/" else one - whole * other
    else:
        value = {"+": one + other, "-": one - other, "*": one * other}[sign]
    if abs(value) > _LARGEST:
        raise ValueError
    return value


def _unknown(text: str) -> Nothing:
    shown = text if len(text) <= 80 else f"{text[:80]}…"
    return Nothing(f"`{shown}` is not known", "import the list of constants that declares it too", "SHM602")
