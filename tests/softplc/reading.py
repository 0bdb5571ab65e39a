"""Reads Structured Text into blark's trees, one for each TYPE, VAR_GLOBAL, block, program and method.

blark is an Earley parser and needs 0.25 ms for each character. Comments and needless blanks are therefore removed, and
names, strings and numbers are replaced by placeholders. Equal texts are then parsed once, and the trees are cached for
the next run. A thousand generated publishers differ only in the replaced words.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.metadata
import multiprocessing
import os
import pickle
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

import blark
from blark import transform as b

from tests.softplc.iec import ELEMENTARY
from tests.support import kept


class Unsupported(Exception):
    """A construct that the translator cannot translate exactly and therefore refuses."""


class CompileError(Exception):
    """An error that CODESYS would report, or that g++ reports for the translated text."""


@dataclass(frozen=True)
class Source:
    """One object. `stem` is that of its file, `attributes` are the pragmas before it, and `tree` is blark's tree."""

    file: str
    attributes: Mapping[str, str]
    tree: Any

    @property
    def stem(self) -> str:
        return PurePath(self.file).stem


def read(files: Mapping[str, str]) -> list[Source]:
    """Return the objects of all files in order. Raises Unsupported for other text and for text with errors."""
    pieces = [piece for file, text in files.items() for piece in _pieces(file, text)]
    parts = [[_replace_names(part) for part in _parts(piece.text)] for piece in pieces]
    trees = _parse_all(dict.fromkeys(text for numbered in parts for text, _ in numbered))
    sources = []
    for piece, numbered in zip(pieces, parts, strict=True):
        for text, _ in numbered:
            if isinstance(trees[text], str):
                raise Unsupported(f"{piece.file}:{piece.line}: {trees[text]}")
        tree = _join([_restore_names(trees[text], names) for text, names in numbered])
        sources.append(Source(piece.file, piece.attributes, tree))
    return sources


@dataclass
class _Piece:
    """The text of one object, without comments."""

    file: str
    line: int
    text: str
    attributes: dict[str, str] = field(default_factory=dict)


_ENDS = {
    "TYPE": "END_TYPE",
    "VAR_GLOBAL": "END_VAR",
    "FUNCTION_BLOCK": "END_FUNCTION_BLOCK",
    "PROGRAM": "END_PROGRAM",
    "METHOD": "END_METHOD",
}
_LIST = re.compile(r"(TYPE \w+:STRUCT |VAR_GLOBAL (?:CONSTANT )?)(.*;)(END_STRUCT END_TYPE|END_VAR)", re.IGNORECASE)
_TOKEN = re.compile(
    r"""(?P<comment>//[^\n]*|\(\*.*?\*\))|(?P<pragma>\{[^}]*\})|(?P<blank>\s+)"""
    r"""|(?P<word>[A-Za-z_]\w*)|(?P<text>'(?:\$.|[^'$])*'|"(?:\$.|[^"$])*")"""
    r"""|(?P<based>16\#[0-9A-Fa-f_]+)|(?P<real>\d+\.\d+([eE][+-]?\d+)?)"""
    r"""|(?P<number>(?<![\#\w.])\d+(?![\#\w]|\.\d))|(?P<other>\d\w*|.)""",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"\{\s*attribute\s+'([\w-]+)'(?:\s*:=\s*'([^']*)')?\s*\}", re.IGNORECASE)
_TIGHT = frozenset("()[];,:")


def _pieces(file: str, text: str) -> Iterator[_Piece]:
    attributes: dict[str, str] = {}
    piece, end, line, spaced = None, "", 1, False
    for token in _TOKEN.finditer(text):
        word = token[0]
        match token.lastgroup:
            case "comment" | "blank":
                spaced = True
            case "pragma":
                attribute = _ATTRIBUTE.fullmatch(word)
                if attribute is None or piece is not None:
                    raise Unsupported(f"{file}:{line}: the pragma {word}")
                attributes[attribute[1].lower()] = attribute[2] or ""
            case kind if piece is not None:
                tight = not spaced or word in _TIGHT or piece.text[-1] in _TIGHT
                piece.text += word if tight else f" {word}"
                spaced = False
                if kind == "word" and word.upper() == end:
                    yield piece
                    piece, attributes = None, {}
            case "word" if word.upper() in _ENDS:
                piece, end, spaced = _Piece(file, line, word, attributes), _ENDS[word.upper()], False
            case _:
                raise Unsupported(f"{file}:{line}: {word} outside of TYPE, VAR_GLOBAL, a block, a program or a method")
        line += word.count("\n")
    if piece is not None:
        raise Unsupported(f"{file}:{piece.line}: {piece.text.split()[0]} without {end}")


def _parts(text: str) -> Iterator[str]:
    """Yield a list for each member of a long list, because few members differ."""
    match = _LIST.fullmatch(text)
    if match is None:
        yield text
        return
    head, members, tail = match.groups()
    start = 0
    for token in _TOKEN.finditer(members):
        if token[0] == ";":
            yield head + members[start : token.end()] + tail
            start = token.end()


def _join(trees: list[Any]) -> Any:
    """Join the trees of the parts that _parts() has yielded."""
    first, *others = trees
    for other in others:
        if isinstance(first, b.GlobalVariableDeclarations):
            first.items.extend(other.items)
        else:
            first.declaration.declarations.extend(other.declaration.declarations)
    return first


def _replace_names(text: str) -> tuple[str, dict[str, str]]:
    """Return the text with numbered placeholders for names, strings and numbers, and the original of each placeholder.

    Names are words before a colon, and words with a small letter. Keywords have only capitals here.
    """
    originals: dict[str, str] = {}

    def placeholder(token: re.Match[str]) -> str:
        word, number = token[0], len(originals)
        match token.lastgroup:
            case "word" if word.upper() != word or (text.startswith(":", token.end()) and word not in ELEMENTARY):
                originals[f"Name{number}x"] = word
            case "text":
                originals[f"{word[0]}Text{number}{word[0]}"] = word
            case "based":
                originals[f"ABCDEF{number}"] = word[3:]
                return f"16#ABCDEF{number}"
            case "number":
                originals[f"7770{number}"] = word
            case _:
                return word
        return next(reversed(originals))

    return _TOKEN.sub(placeholder, text), originals


def _parse_all(texts: Iterable[str]) -> dict[str, Any]:
    """Return the trees by text. Many texts are parsed in processes, spawned because a test runner has threads."""
    names = {text: f"tree-{kept.key(_parser_key(), text)}" for text in texts}
    trees = _load_cached(names)
    if names.keys() == trees.keys():
        return trees
    with kept.cache_locked("trees"):  # another worker may be parsing the same texts
        trees = _load_cached(names)
        new = sorted(names.keys() - trees.keys(), key=len, reverse=True)
        if sum(map(len, new)) < 20_000:
            new_trees = dict(zip(new, map(_parse, new), strict=True))
        else:
            with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
                new_trees = dict(zip(new, pool.map(_parse, new, chunksize=4), strict=True))
        for text, tree in new_trees.items():
            kept.keep(names[text], pickle.dumps(tree))
    return trees | new_trees


def _load_cached(names: Mapping[str, str]) -> dict[str, Any]:
    """Return the cached trees by text. `names` maps each text to the name of its tree in the cache."""
    entries = {text: kept.find(name) for text, name in names.items()}
    return {text: pickle.loads(data) for text, data in entries.items() if data is not None}


@functools.cache
def _parser_key() -> str:
    """Return a key for blark, Python and this file. Texts whose trees have another key are parsed again."""
    return kept.key(importlib.metadata.version("blark"), sys.version, Path(__file__).read_bytes())


def _parse(text: str) -> Any:
    """Return blark's tree, or an error message if blark cannot parse the text."""
    result = blark.parse_source_code(text)
    if result.exception is not None:
        return f"blark cannot read it: {str(result.exception).splitlines()[0]}"
    (item,) = result.transform().items
    return _without_positions(item)


def _without_positions(node: Any) -> Any:
    """Return the tree without positions, which would refer to the shortened text."""
    if isinstance(node, list):
        return [_without_positions(item) for item in node]
    if dataclasses.is_dataclass(node) and not isinstance(node, type):
        bare = object.__new__(type(node))
        vars(bare).update((name, _without_positions(value)) for name, value in vars(node).items() if name != "meta")
        return bare
    return str(node) if isinstance(node, str) else node


def _restore_names(node: Any, names: Mapping[str, str]) -> Any:
    if isinstance(node, list):
        return [_restore_names(item, names) for item in node]
    if isinstance(node, str):
        if node in names or "Name" not in node:
            return names.get(node) or ("-" + names[node[1:]] if node[1:] in names and node[0] == "-" else node)
        return ".".join(names.get(part, part) for part in node.split("."))
    if dataclasses.is_dataclass(node) and not isinstance(node, type):
        restored = object.__new__(type(node))
        vars(restored).update((name, _restore_names(value, names)) for name, value in vars(node).items())
        return restored
    return node
