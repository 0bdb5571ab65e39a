"""Turns Structured Text into the data types and constants that it declares.

Of a file only `TYPE … END_TYPE` and `VAR_GLOBAL CONSTANT … END_VAR` are looked at; all else is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Span


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
    """Structured Text that ends, or goes on, as no declaration does."""

    def __init__(self, message: str, span: Span) -> None:
        super().__init__(message)
        self.message, self.span = message, span


class _Token(NamedTuple):
    kind: str
    text: str
    line: int
    column: int


_TOKEN = re.compile(
    r"""(?P<comment>\(\*[\s\S]*?\*\)|//[^\n]*)|(?P<pragma>\{[^}]*\})|(?P<text>'(?:\$.|[^'$])*'|"(?:\$.|[^"$])*")"""
    r"""|(?P<word>[A-Za-z_]\w*(?:\#[-+\w.:]+)?|\d+\#[0-9A-Fa-f_]+|\d[\d_]*(?:\.(?!\.)[\d_]+)?(?:[eE][-+]?\d+)?)"""
    r"""|(?P<sign>\.\.|:=|\S)|(?P<blank>\s+)"""
)
_PACK = re.compile(r"pack_mode'\s*:=\s*'(\d+)'")


def read(text: str, path: str, first_line: int = 1) -> tuple[list[Declared], dict[str, str]]:
    """The types, and the global constants with their values as they are spelled. Raises Unreadable."""
    reader = _Reader(text, path, first_line)
    types: list[Declared] = []
    constants: dict[str, str] = {}
    while token := reader.next():
        word = token.text.upper()
        if token.kind == "word" and word == "TYPE":
            types += reader.types(token)
        elif token.kind == "word" and word == "VAR_GLOBAL" and reader.peek().upper() == "CONSTANT":
            constants |= {member.name.upper(): member.value for member in reader.members(("END_VAR",)) if member.value}
    return types, constants


class _Reader:
    """Walks over the tokens; comments are kept aside, with the lines they stand in."""

    def __init__(self, text: str, path: str, first_line: int) -> None:
        self.path, self.lines, self.first = path, text.split("\n"), first_line
        self.tokens: list[_Token] = []
        self.comments: list[_Token] = []
        self.pragmas: list[_Token] = []
        line, start = 1, 0
        for found in _TOKEN.finditer(text):
            kind, word = str(found.lastgroup), found[0]
            token = _Token(kind, word, line, found.start() - start + 1)
            {"comment": self.comments, "pragma": self.pragmas, "blank": []}.get(kind, self.tokens).append(token)
            if (breaks := word.count("\n")) > 0:
                line += breaks
                start = found.start() + word.rindex("\n") + 1
        self.at = 0

    def next(self) -> _Token | None:
        self.at += 1
        return self.tokens[self.at - 1] if self.at <= len(self.tokens) else None

    def peek(self, ahead: int = 0) -> str:
        return self.tokens[self.at + ahead].text if self.at + ahead < len(self.tokens) else ""

    def span(self, token: _Token) -> Span:
        text = self.lines[token.line - 1].rstrip("\r")
        width = len(token.text.partition("\n")[0])
        return Span(self.path, token.line + self.first - 1, token.column, width, text)

    def need(self, *words: str) -> _Token:
        token = self.next()
        if token is None or (words and token.text.upper() not in words):
            wanted = " or ".join(words) or "more"
            here = token or self.tokens[-1]
            raise Unreadable(f"expected {wanted}, found {f'`{here.text}`' if token else 'the end'}", self.span(here))
        return token

    def types(self, opening: _Token) -> Iterator[Declared]:
        after = self.tokens[self.at - 2].line if self.at > 1 else 0
        while self.peek().upper() != "END_TYPE":
            while self.peek().upper() in ("PUBLIC", "INTERNAL") and self.peek(1) != ":":
                self.next()
            name = self.need()
            extends = ""
            while self.peek() != ":":
                word = self.need().text
                extends = self.need().text if word.upper() == "EXTENDS" else extends
            self.need(":")
            packs = [_PACK.search(it.text) for it in self.pragmas if after < it.line <= name.line]
            pack = next((int(it[1]) for it in packs if it), 0)
            comment = self.comment(after, max(name.line - 1, opening.line - 1))
            yield self._type(name, extends, pack, comment)
            after = self.tokens[self.at - 1].line
        self.need("END_TYPE")

    def _type(self, name: _Token, extends: str, pack: int, comment: str) -> Declared:
        span = self.span(name)
        word = self.peek().upper()
        if word in ("STRUCT", "UNION"):
            self.need()
            members = tuple(self.members((f"END_{word}",)))
            if self.peek() == ";":
                self.need()
            return Declared(name.text, word.lower(), members, "", extends, pack, comment, span)
        if word == "(":
            self.need()
            members = tuple(self.enumerators())
            base, _ = self.until(";")
            return Declared(name.text, "enum", members, base.partition(":=")[0].strip(), extends, pack, comment, span)
        base, _ = self.until(";")
        return Declared(name.text, "alias", (), base.partition(":=")[0].strip(), extends, pack, comment, span)

    def members(self, ends: tuple[str, ...]) -> Iterator[Member]:
        """`a, b AT %I* : TYPE := value;` up to one of `ends`."""
        after = self.tokens[self.at - 1].line
        while self.peek().upper() not in ends:
            if self.peek().upper() in ("CONSTANT", "PERSISTENT", "RETAIN"):
                self.need()
                continue
            names = [self.need()]
            while self.peek() == ",":
                self.need()
                names.append(self.need())
            while self.peek() != ":":
                self.need()
            self.need(":")
            declared, last = self.until(";")
            type_, _, value = (part.strip() for part in declared.partition(":="))
            above = self.comment(after, names[0].line - 1)
            beside = self.comment(last.line - 1, last.line)
            for name in names:
                yield Member(name.text, type_, value, "\n".join(filter(None, [above, beside])), self.span(name))
            after = last.line
        self.need(*ends)

    def enumerators(self) -> Iterator[Member]:
        """`idle := 0, moving` up to the bracket that closes them."""
        after = self.tokens[self.at - 1].line
        while self.peek() != ")":
            name = self.need()
            value = ""
            if self.peek() == ":=":
                self.need()
                value, _ = self.until(",", ")", keep=True)
            last = self.tokens[self.at - 1]
            if self.peek() == ",":
                last = self.need()
            above, beside = self.comment(after, name.line - 1), self.comment(last.line - 1, last.line)
            yield Member(name.text, "", value, "\n".join(filter(None, [above, beside])), self.span(name))
            after = last.line
        self.need(")")

    def until(self, *ends: str, keep: bool = False) -> tuple[str, _Token]:
        """The text up to one of `ends` outside brackets, and the last token; `keep` leaves that one to be read."""
        words: list[str] = []
        depth = 0
        while True:
            if depth == 0 and self.peek() in ends:
                last = self.tokens[self.at - 1] if keep else self.need()
                return _spelled(words), last
            token = self.need()
            depth += {"(": 1, "[": 1, ")": -1, "]": -1}.get(token.text, 0)
            words.append(token.text)

    def comment(self, after: int, last: int) -> str:
        """Those that begin behind line `after`, and not behind line `last`."""
        return "\n".join(_said(it.text) for it in self.comments if after < it.line <= last)


def _spelled(words: list[str]) -> str:
    """With a blank where two words touch, and around an assignment."""
    text = ""
    for word in words:
        blank = (text and re.search(r"\w$", text) and re.match(r"\w", word)) or ":=" in (word, text[-2:])
        text += f" {word}" if blank or ((word == "OF" or text.endswith((" OF", "]"))) and word not in ")]") else word
    return text.strip()


def _said(comment: str) -> str:
    """Without its marks."""
    text = comment[2:-2] if comment.startswith("(*") else comment.lstrip("/")
    return "\n".join(line.strip(" \t\r*") for line in text.split("\n")).strip()
