"""Parse the data types and constants that Structured Text declares.

Only `TYPE … END_TYPE` and `VAR_GLOBAL CONSTANT … END_VAR` are parsed. All other text is skipped.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Span
from shmgen.core.escape import legible

MOST = 1_000_000
"""The limit of members in a project, and of elements in an XML file. The largest known project has some 50,000."""


class Member(NamedTuple):
    """A member of a structure, a name of an enumeration, or a constant.

    `type` is spelled as in Structured Text. A name of an enumeration has the type `""`.
    """

    name: str
    type: str
    value: str
    comment: str
    span: Span


class Declaration(NamedTuple):
    """A data type of a PLC project, as declared. `kind` is struct, enum, union or alias.

    `base` is the base type of an enumeration or alias. `extends` is the structure that this structure extends, or `""`.
    `pack` is the largest alignment of a member in bytes, or 0 without a limit.
    """

    name: str
    kind: str
    members: tuple[Member, ...]
    base: str
    extends: str
    pack: int
    comment: str
    span: Span
    mistyped_pack: str = ""
    """An attribute that was probably meant as a pack_mode, or `""`."""


class Unreadable(Exception):
    """A declaration or file has invalid syntax or is too large."""

    def __init__(self, message: str, span: Span) -> None:
        super().__init__(message)
        self.message, self.span = message, span


def name(text: str, span: Span) -> str:
    """Return `text`. Raises Unreadable if `text` is not a valid name, which could inject code into generated files."""
    if not _NAME.fullmatch(text):
        raise Unreadable(f"`{legible(text[:40])}` is not a name", span)
    return text


def pack_mode(attributes: Iterable[tuple[str, str]]) -> tuple[int, str]:
    """Return the largest alignment of a member in bytes, or 0 without a limit, from the attributes of a structure.

    The second result is an attribute that was probably meant as a pack_mode, or `""`. `attributes` are names and
    values; the values include quotes, as in `'1'`. CODESYS and TwinCAT treat pack_mode 0 as 1.
    """
    mistyped = ""
    for called, value in attributes:
        if called == "pack_mode" and value in _PACKS:
            return _PACKS[value], ""
        if re.sub(r"[\W_]", "", called).lower() == "packmode":
            mistyped = f"'{called[:40]}' := {value[:40]}"
    return 0, mistyped


_PACKS = {"'0'": 1, "'1'": 1, "'2'": 2, "'4'": 4, "'8'": 0}


class _Token(NamedTuple):
    kind: str
    text: str
    line: int
    column: int


_NAME = re.compile(r"[^\W\d]\w{0,199}")
_TOKEN = re.compile(
    r"""(?P<comment>\(\*[\s\S]*?\*\)|//[^\n]*)|(?P<pragma>\{[^}]*\})"""
    r"""|(?P<text>'(?:\$.|[^'$\n])*'|"(?:\$.|[^"$\n])*")|(?P<open>\(\*|[{'"])"""
    r"""|(?P<word>[^\W\d]\w*(?:\#[-+\w.:]+)?|\d+\#[0-9A-Fa-f_]+|\d[\d_]*(?:\.(?!\.)[\d_]+)?(?:[eE][-+]?\d+)?)"""
    r"""|(?P<sign>\.\.|:=|\S)|(?P<blank>\s+)"""
)
_ATTRIBUTE = re.compile(r"\{\s*attribute\s+'([^'\n]*)'\s*(?::=\s*([^\n]*?)\s*)?\}", re.IGNORECASE)
_ACCESS = ("PUBLIC", "INTERNAL", "PROTECTED", "PRIVATE", "ABSTRACT", "FINAL")
_KEPT = ("CONSTANT", "PERSISTENT", "RETAIN")
_LONGEST_LINE = 400
"""The longest line in characters that diagnostics show."""


def read(text: str, path: str, first_line: int = 1) -> tuple[list[Declaration], list[Member]]:
    """Parse the Structured Text of a file. Return its data types and its global constants.

    Raises Unreadable if a declaration has invalid syntax.
    """
    reader = _Reader(text, path, first_line)
    types: list[Declaration] = []
    constants: list[Member] = []
    while token := reader.next():
        word = token.text.upper() if token.kind == "word" else ""
        if word == "TYPE":
            types += reader.types()
        elif word == "VAR_GLOBAL" and "CONSTANT" in (reader.peek().upper(), reader.peek(1).upper()):
            constants += (member for member in reader.members(("END_VAR",)) if member.value)
        reader.asides()
        reader.beside()
    return types, constants


class _Reader:
    """Parses the words of Structured Text. Comments and pragmas wait in `aside` until their declaration takes them."""

    def __init__(self, text: str, path: str, first_line: int) -> None:
        self.path, self.lines, self.first = path, [line.rstrip("\r") for line in text.split("\n")], first_line
        self.tokens = self.scan(text)
        self.coming: deque[_Token] = deque()
        self.aside: deque[tuple[int, _Token]] = deque()
        """Comments and pragmas, each with the number of the next token."""
        self.at = 0
        self.last = _Token("", "", 0, 1)

    def scan(self, text: str) -> Iterator[_Token]:
        line, start, ahead = 1, 0, 0
        for match in _TOKEN.finditer(text):
            kind, word = str(match.lastgroup), match[0]
            token = _Token(kind, word, line, match.start() - start + 1)
            if kind == "open":
                raise Unreadable(f"`{word}` has no end", self.span(token))
            if kind in ("comment", "pragma"):
                self.aside.append((ahead, token))
            elif kind != "blank":
                ahead += 1
                yield token
            if (breaks := word.count("\n")) > 0:
                line += breaks
                start = match.start() + word.rindex("\n") + 1

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
        excerpt = text if len(text) <= _LONGEST_LINE else ""
        return Span(
            self.path, token.line + self.first - 1, token.column, len(token.text.partition("\n")[0][:80]), excerpt
        )

    def need(self, *words: str) -> _Token:
        token = self.next()
        if token is None or (words and token.text.upper() not in words):
            expected = " or ".join(words) or "more"
            actual = f"`{token.text[:40]}`" if token else "the end"
            raise Unreadable(f"expected {expected}, found {actual}", self.span(token or self.last))
        return token

    def name(self) -> _Token:
        token = self.need()
        name(token.text, self.span(token))
        return token

    def asides(self) -> list[_Token]:
        """Remove and return the comments and pragmas before the last token."""
        tokens = []
        while self.aside and self.aside[0][0] < self.at:
            tokens.append(self.aside.popleft()[1])
        return tokens

    def beside(self) -> list[_Token]:
        """Remove and return the comments directly after the last token, on its line."""
        self.peek()
        comments = []
        while self.aside and self.aside[0][0] == self.at and self.aside[0][1].line == self.last.line:
            if self.aside[0][1].kind == "pragma":
                break
            comments.append(self.aside.popleft()[1])
        return comments

    def types(self) -> Iterator[Declaration]:
        before = self.asides()
        while self.peek().upper() != "END_TYPE":
            while self.peek().upper() in _ACCESS and self.peek(1) != ":":
                self.next()
            called = self.name()
            before += self.asides()
            head = self.until(":")
            extends = "".join(head[1:]) if head and head[0].upper() == "EXTENDS" else ""
            attributes = (_ATTRIBUTE.fullmatch(it.text) for it in before if it.kind == "pragma")
            pack, mistyped = pack_mode((it[1], it[2] or "") for it in attributes if it)
            declared = self._type(called, extends, pack)
            yield declared._replace(comment=_comment_text(before, declared.comment), mistyped_pack=mistyped)
            self.beside()
            before = []
        self.need("END_TYPE")
        self.beside()

    def _type(self, called: _Token, extends: str, pack: int) -> Declaration:
        span = self.span(called)
        word = self.peek().upper()
        members: tuple[Member, ...] = ()
        if word in ("STRUCT", "UNION"):
            self.need()
            comment = _comment_text(self.asides() + self.beside())
            members = tuple(self.members((f"END_{word}",)))
            if self.peek() == ";":
                self.need()
            return Declaration(called.text, word.lower(), members, "", extends, pack, comment, span)
        is_enum = word == "("
        if is_enum:
            self.need()
            members = tuple(self.enumerators())
        base = self.until(";")
        comment = _comment_text(self.asides() + self.beside())
        kind = "enum" if is_enum else "alias"
        return Declaration(called.text, kind, members, _join_words(_halves(base)[0]), extends, pack, comment, span)

    def members(self, ends: tuple[str, ...]) -> Iterator[Member]:
        """Read declarations such as `a, b AT %I* : TYPE := value;` up to one of the words `ends`. Yield the members."""
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
            declared = self.until(";")
            type_, value = map(_join_words, _halves(declared))
            comment = _comment_text(self.asides() + self.beside())
            count += len(names)
            if count > MOST:
                raise Unreadable(f"more than {MOST:,} members", self.span(names[0]))
            for it in names:
                yield Member(it.text, type_, value, comment, self.span(it))
        self.need(*ends)

    def enumerators(self) -> Iterator[Member]:
        """Read and yield the names of an enumeration such as `idle := 0, moving`, up to the closing bracket."""
        count = 0
        while self.peek() != ")":
            it = self.name()
            value: list[str] = []
            if self.peek() == ":=":
                self.need()
                value = self.until(",", ")", keep=True)
            if self.peek() == ",":
                self.need()
            comment = _comment_text(self.asides() + self.beside())
            count += 1
            if count > MOST:
                raise Unreadable(f"more than {MOST:,} names", self.span(it))
            yield Member(it.text, "", _join_words(value), comment, self.span(it))
        self.need(")")

    def until(self, *ends: str, keep: bool = False) -> list[str]:
        """Read up to the first word that is in `ends` and outside brackets. Return the words before it.

        If `keep` is True, this word stays unread.
        """
        words: list[str] = []
        depth = 0
        while True:
            if depth == 0 and self.peek() in ends:
                if not keep:
                    self.need()
                return words
            token = self.need()
            if token.text == ";":
                raise Unreadable(f"expected {' or '.join(ends)}, found `;`", self.span(token))
            depth += _BRACKETS.get(token.text, 0)
            words.append(token.text)


_BRACKETS = {"(": 1, "[": 1, ")": -1, "]": -1}


def _halves(words: list[str]) -> tuple[list[str], list[str]]:
    """Return the words before and the words after the assignment sign `:=` outside brackets."""
    depth = 0
    for place, word in enumerate(words):
        depth += _BRACKETS.get(word, 0)
        if word == ":=" and depth == 0:
            return words[:place], words[place + 1 :]
    return words, []


def _join_words(words: Iterable[str]) -> str:
    """Join words to Structured Text, with the usual blanks: between two names, for example, but not before `[`."""
    parts: list[str] = []
    last = ""
    for word in words:
        touch = last and re.match(r"\w", last[-1]) and re.match(r"\w", word)
        of = (word == "OF" or last in ("OF", "]")) and word not in ")]"
        parts.append(f" {word}" if touch or of or ":=" in (word, last) else word)
        last = word
    return "".join(parts).strip()


def _comment_text(asides: Iterable[_Token], more: str = "") -> str:
    """Return the text of comments without comment marks, and `more` after the comments."""
    texts = [
        it.text[2:-2] if it.text.startswith("(*") else it.text.lstrip("/") for it in asides if it.kind == "comment"
    ]
    lines = [line.strip(" \t\r*") for text in texts for line in text.split("\n")]
    return "\n".join([*lines, *filter(None, [more])]).strip()
