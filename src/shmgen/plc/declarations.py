"""Reads the data types and constants that Structured Text declares.

Of a file only `TYPE … END_TYPE` and `VAR_GLOBAL CONSTANT … END_VAR` are looked at; all else is passed over.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Span
from shmgen.core.escape import legible

MOST = 1_000_000
"""Members of all types of a project, or elements of one XML; the largest known to us has some 50,000."""


class Member(NamedTuple):
    """Of a structure, or a name of an enumeration, which has no type. `type` is spelled as in Structured Text."""

    name: str
    type: str
    value: str
    comment: str
    span: Span


class Declared(NamedTuple):
    """A data type. `kind` is struct, enum, union or alias; `base` is what an enumeration or an alias is made of."""

    name: str
    kind: str
    members: tuple[Member, ...]
    base: str
    extends: str
    pack: int
    comment: str
    span: Span


class Unreadable(Exception):
    """What ends, or goes on, as no declaration does."""

    def __init__(self, message: str, span: Span) -> None:
        super().__init__(message)
        self.message, self.span = message, span


def name(text: str, span: Span) -> str:
    """A name as the IDE allows it, so that it is one wherever it is printed. Raises Unreadable."""
    if not _NAME.fullmatch(text):
        raise Unreadable(f"`{legible(text[:40])}` is not a name", span)
    return text


def pack_mode(digits: str) -> int:
    """0 where nothing is packed to so many bytes."""
    return int(digits) if digits in ("1", "2", "4") else 0


class _Token(NamedTuple):
    kind: str
    text: str
    line: int
    column: int


_NAME = re.compile(r"[A-Za-z_]\w{0,199}")
_TOKEN = re.compile(
    r"""(?P<comment>\(\*[\s\S]*?\*\)|//[^\n]*)|(?P<pragma>\{[^}]*\})"""
    r"""|(?P<text>'(?:\$.|[^'$\n])*'|"(?:\$.|[^"$\n])*")|(?P<open>\(\*|[{'"])"""
    r"""|(?P<word>[A-Za-z_]\w*(?:\#[-+\w.:]+)?|\d+\#[0-9A-Fa-f_]+|\d[\d_]*(?:\.(?!\.)[\d_]+)?(?:[eE][-+]?\d+)?)"""
    r"""|(?P<sign>\.\.|:=|\S)|(?P<blank>\s+)"""
)
_PACK = re.compile(r"pack_mode'\s*:=\s*'(\d+)'")
_ACCESS = ("PUBLIC", "INTERNAL", "PROTECTED", "PRIVATE", "ABSTRACT", "FINAL")
_KEPT = ("CONSTANT", "PERSISTENT", "RETAIN")
_LONGEST_LINE = 400
"""A longer one is not shown."""


def read(text: str, path: str, first_line: int = 1) -> tuple[list[Declared], list[Member]]:
    """The types, and the global constants with their values as they are spelled. Raises Unreadable."""
    reader = _Reader(text, path, first_line)
    types: list[Declared] = []
    constants: list[Member] = []
    while token := reader.next():
        word = token.text.upper() if token.kind == "word" else ""
        if word == "TYPE":
            types += reader.types()
        elif word == "VAR_GLOBAL" and "CONSTANT" in (reader.peek().upper(), reader.peek(1).upper()):
            constants += (member for member in reader.members(("END_VAR",)) if member.value)
        reader.asides(reader.at - 1)
        reader.beside()
    return types, constants


class _Reader:
    """Walks over the tokens; comments and pragmas wait aside until the declaration that they belong to takes them."""

    def __init__(self, text: str, path: str, first_line: int) -> None:
        self.path, self.lines, self.first = path, [line.rstrip("\r") for line in text.split("\n")], first_line
        self.tokens = self.scan(text)
        self.coming: deque[_Token] = deque()
        self.aside: deque[tuple[int, _Token]] = deque()
        """With the number of the token that follows."""
        self.at = self.count = 0
        self.last = _Token("", "", 0, 1)

    def scan(self, text: str) -> Iterator[_Token]:
        line, start, ahead = 1, 0, 0
        for found in _TOKEN.finditer(text):
            kind, word = str(found.lastgroup), found[0]
            token = _Token(kind, word, line, found.start() - start + 1)
            if kind == "open":
                raise Unreadable(f"`{word}` has no end", self.span(token))
            if kind in ("comment", "pragma"):
                self.aside.append((ahead, token))
            elif kind != "blank":
                ahead += 1
                yield token
            if (breaks := word.count("\n")) > 0:
                line += breaks
                start = found.start() + word.rindex("\n") + 1

    def next(self) -> _Token | None:
        if not self.peek():
            return None
        self.at += 1
        self.last = self.coming.popleft()
        return self.last

    def peek(self, ahead: int = 0) -> str:
        while len(self.coming) <= ahead:
            token = next(self.tokens, None)
            if token is None:
                return ""
            self.coming.append(token)
        return self.coming[ahead].text

    def span(self, token: _Token) -> Span:
        text = self.lines[token.line - 1] if token.line else ""
        shown = text if len(text) <= _LONGEST_LINE else ""
        return Span(
            self.path, token.line + self.first - 1, token.column, len(token.text.partition("\n")[0][:80]), shown
        )

    def need(self, *words: str) -> _Token:
        token = self.next()
        if token is None or (words and token.text.upper() not in words):
            wanted = " or ".join(words) or "more"
            found = f"`{token.text[:40]}`" if token else "the end"
            raise Unreadable(f"expected {wanted}, found {found}", self.span(token or self.last))
        return token

    def name(self) -> _Token:
        token = self.need()
        name(token.text, self.span(token))
        return token

    def asides(self, last: int) -> list[_Token]:
        """Comments and pragmas before token number `last`, each given out once."""
        found = []
        while self.aside and self.aside[0][0] <= last:
            found.append(self.aside.popleft()[1])
        return found

    def beside(self) -> list[_Token]:
        """The comments right behind the last token, in its line."""
        self.peek()
        found = []
        while self.aside and self.aside[0][0] == self.at and self.aside[0][1].line == self.last.line:
            if self.aside[0][1].kind == "pragma":
                break
            found.append(self.aside.popleft()[1])
        return found

    def types(self) -> Iterator[Declared]:
        before = self.asides(self.at - 1)
        while self.peek().upper() != "END_TYPE":
            while self.peek().upper() in _ACCESS and self.peek(1) != ":":
                self.next()
            called = self.name()
            before += self.asides(self.at - 1)
            head, _ = self.until(":")
            extends = "".join(head[1:]) if head and head[0].upper() == "EXTENDS" else ""
            packs = [_PACK.search(it.text) for it in before if it.kind == "pragma"]
            pack = next((pack_mode(it[1]) for it in packs if it), 0)
            declared = self._type(called, extends, pack)
            yield declared._replace(comment=_said(before, declared.comment))
            self.beside()
            before = []
        self.need("END_TYPE")
        self.beside()

    def _type(self, called: _Token, extends: str, pack: int) -> Declared:
        span = self.span(called)
        word = self.peek().upper()
        members: tuple[Member, ...] = ()
        if word in ("STRUCT", "UNION"):
            self.need()
            comment = _said(self.asides(self.at - 1) + self.beside())
            members = tuple(self.members((f"END_{word}",)))
            if self.peek() == ";":
                self.need()
            return Declared(called.text, word.lower(), members, "", extends, pack, comment, span)
        is_enum = word == "("
        if is_enum:
            self.need()
            members = tuple(self.enumerators())
        base, _ = self.until(";")
        comment = _said(self.asides(self.at - 1) + self.beside())
        kind = "enum" if is_enum else "alias"
        return Declared(called.text, kind, members, _spelled(_halves(base)[0]), extends, pack, comment, span)

    def members(self, ends: tuple[str, ...]) -> Iterator[Member]:
        """`a, b AT %I* : TYPE := value;` up to one of `ends`."""
        count = 0
        while self.peek().upper() not in ends:
            if self.peek().upper() in (*_KEPT, ";"):
                self.need()
                continue
            names = [self.name()]
            while self.peek() == ",":
                self.need()
                names.append(self.name())
            self.until(":")
            declared, _ = self.until(";")
            type_, value = map(_spelled, _halves(declared))
            comment = _said(self.asides(self.at - 1) + self.beside())
            count += len(names)
            if count > MOST:
                raise Unreadable(f"more than {MOST:,} members", self.span(names[0]))
            for it in names:
                yield Member(it.text, type_, value, comment, self.span(it))
        self.need(*ends)

    def enumerators(self) -> Iterator[Member]:
        """`idle := 0, moving` up to the bracket that closes them."""
        count = 0
        while self.peek() != ")":
            it = self.name()
            value: list[str] = []
            if self.peek() == ":=":
                self.need()
                value, _ = self.until(",", ")", keep=True)
            if self.peek() == ",":
                self.need()
            comment = _said(self.asides(self.at - 1) + self.beside())
            count += 1
            if count > MOST:
                raise Unreadable(f"more than {MOST:,} names", self.span(it))
            yield Member(it.text, "", _spelled(value), comment, self.span(it))
        self.need(")")

    def until(self, *ends: str, keep: bool = False) -> tuple[list[str], _Token]:
        """The words up to one of `ends` outside brackets, and the last token; `keep` leaves that one to be read."""
        words: list[str] = []
        depth = 0
        while True:
            if depth == 0 and self.peek() in ends:
                return words, self.last if keep else self.need()
            token = self.need()
            if token.text == ";":
                raise Unreadable(f"expected {' or '.join(ends)}, found `;`", self.span(token))
            depth += _BRACKETS.get(token.text, 0)
            words.append(token.text)


_BRACKETS = {"(": 1, "[": 1, ")": -1, "]": -1}


def _halves(words: list[str]) -> tuple[list[str], list[str]]:
    """Before and behind an assignment outside brackets."""
    depth = 0
    for place, word in enumerate(words):
        depth += _BRACKETS.get(word, 0)
        if word == ":=" and depth == 0:
            return words[:place], words[place + 1 :]
    return words, []


def _spelled(words: Iterable[str]) -> str:
    """With a blank where two words touch, and around an assignment."""
    parts: list[str] = []
    last = ""
    for word in words:
        touch = last and re.match(r"\w", last[-1]) and re.match(r"\w", word)
        of = (word == "OF" or last in ("OF", "]")) and word not in ")]"
        parts.append(f" {word}" if touch or of or ":=" in (word, last) else word)
        last = word
    return "".join(parts).strip()


def _said(asides: Iterable[_Token], more: str = "") -> str:
    """Comments without their marks."""
    texts = [
        it.text[2:-2] if it.text.startswith("(*") else it.text.lstrip("/") for it in asides if it.kind == "comment"
    ]
    lines = [line.strip(" \t\r*") for text in texts for line in text.split("\n")]
    return "\n".join([*lines, *filter(None, [more])]).strip()
