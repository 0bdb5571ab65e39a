"""Split the files of each target into tokens of code, for the contract of targets.

The file name determines the language. Comments, docstrings and blanks are not tokens; a string is one token.
"""

from __future__ import annotations

import ast
import configparser
import functools
import io
import json
import keyword
import re
import subprocess
import sys
import tempfile
import tokenize
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path, PurePath
from typing import Any

from lxml import etree
from ruamel.yaml import YAML

from . import open_plc
from .build import put

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class Language:
    """A language: `tokens` splits a text; `accepts` raises an error if a compiler rejects files, given by path.

    `keywords` are reserved words. They are not shared with src/, so that a word forgotten there is found here.
    `name` is the regular expression of a valid name. The default matches few names, so that each language sets it.
    """

    tokens: Callable[[str], list[str]]
    accepts: Callable[[Mapping[str, str]], None] = lambda texts: None
    keywords: frozenset[str] = frozenset()
    ignores_case: bool = False
    name: str = "[a-z][a-z0-9_]*"

    def is_name(self, word: str) -> bool:
        return re.fullmatch(self.name, word, re.ASCII) is not None and self.folded(word) not in self.keywords

    def folded(self, word: str) -> str:
        """Return a form that is equal for names that the language treats as equal."""
        return word.upper() if self.ignores_case and not word.startswith("<") else word


def language(path: str) -> Language:
    for pattern, candidate in LANGUAGES:
        if fnmatch(path, pattern):
            return candidate
    raise AssertionError(f"{path}: tests/support/languages.py does not know what is code in it")


def lexer(*, comments: str, texts: str) -> Callable[[str], list[str]]:
    """Return a function that splits code into tokens. `comments` and `texts` are regular expressions."""
    token = re.compile(rf"(?P<none>{comments}|\s+)|{texts}|\w+|.", re.DOTALL)
    return functools.lru_cache(256)(lambda text: [match[0] for match in token.finditer(text) if not match["none"]])


_DOUBLE = r'"(?:\\.|[^"\\])*"'
_hash = lexer(comments="#[^\n]*", texts=rf"{_DOUBLE}|'[^'\n]*'")
c_tokens = lexer(comments=r"/\*.*?\*/|//[^\n]*", texts=rf"\w*{_DOUBLE}")
st_tokens = lexer(comments=r"//[^\n]*|\(\*.*?\*\)", texts=r"""'(?:\$.|[^'$])*'|"(?:\$.|[^"$])*"|\{attribute [^}]*\}""")


def python_tokens(text: str) -> list[str]:
    """Return the tokens without docstrings."""
    kinds = (tokenize.COMMENT, tokenize.NL, tokenize.ENCODING, tokenize.ENDMARKER)
    tokens = [token for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type not in kinds]
    begins = (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    statement = [
        token.type == tokenize.STRING
        and (number == 0 or tokens[number - 1].type in begins)
        and tokens[number + 1].type == tokenize.NEWLINE
        for number, token in enumerate(tokens)
    ]
    code_tokens = (token for token, is_doc in zip(tokens, statement, strict=True) if not is_doc)
    return [token.string for token in code_tokens if token.type not in begins]


def xml_tokens(text: str) -> list[str]:
    """Return the tokens without documentation and comments. The remaining text is Structured Text or a value."""

    def of(element: Any) -> Iterator[str]:
        if element.tag is not etree.Comment and not str(element.tag).endswith(("}documentation", "description")):
            yield f"<{element.tag}"
            for key, value in sorted(element.attrib.items()):
                is_folder = str(element.tag).endswith("}Folder")  # of the tree in the IDE: any text
                yield from (f"<{key}", *([repr(value)] if is_folder else st_tokens(value)))
            yield from st_tokens(element.text or "")
            for inner in element:
                yield from of(inner)
        yield from st_tokens(element.tail or "")

    return list(of(etree.fromstring(_OBJECT_ID.sub("", text).encode())))


_OBJECT_ID = re.compile(r"[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}")
"""The id of an object in CODESYS, a UUID that depends on the object's name."""


_BODY = re.compile(r"^\{\{$.*?^\}\}$", re.DOTALL | re.MULTILINE)
_STRUCTURE = re.compile(
    r"^typedef struct SHMGEN_PACKED shm_.*?^\}[^;]*;|^(?:struct|class) .*?^\};", re.DOTALL | re.MULTILINE
)


def matiec_tokens(text: str) -> list[str]:
    """Return the tokens without the bodies in C, whose names have their own scopes. The compiler checks the bodies."""
    return st_tokens(_BODY.sub("", text))


def type_tokens(text: str) -> list[str]:
    """Return only the tokens of structures and classes, because names in other code have their own scopes."""
    return [token for match in _STRUCTURE.finditer(text) for token in c_tokens(match[0])]


def stlib_tokens(text: str) -> list[str]:
    """Return the tokens without documentation, and only the structures of the code."""

    def of(value: Any) -> Iterator[str]:
        if isinstance(value, dict):
            for key, inner in value.items():
                yield f"<{key}"
                if key in ("header", "cpp"):
                    yield from type_tokens(inner)
                elif key == "kind":
                    yield f"<{inner}"
                elif key not in ("documentation", "description"):
                    yield from of(inner)
        elif isinstance(value, list):
            for inner in value:
                yield from of(inner)
        else:
            yield str(value)

    return list(of(json.loads(text)))


def _open_plc(texts: Mapping[str, str]) -> None:
    """Check the rules of matiec, and compile the C code with stubs of both compilers."""
    for path, text in texts.items():
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            if path.endswith(".stlib"):
                open_plc.compiled({path: text}, "openplc-v4", folder, PurePath(path).stem, "-fsyntax-only")
            else:
                program = {f"matiec/{PurePath(path).stem}.st": text}
                open_plc.compiled(program, "openplc-v3", folder, PurePath(path).stem, "-fsyntax-only")


def _python(texts: Mapping[str, str]) -> None:
    for path, text in texts.items():
        ast.parse(text)
        if path.startswith("python/"):
            parts = PurePath(path).with_suffix("").parts
            assert all(part.isidentifier() and not keyword.iskeyword(part) for part in parts), path


def _c(texts: Mapping[str, str]) -> None:
    """Compile all headers in one unit, so that no two definitions collide."""
    with tempfile.TemporaryDirectory() as folder:
        put(texts, Path(folder))
        roots = sorted({path.partition("/")[0] for path in texts})
        names = [path.partition("/")[2] for path in texts]
        for standard in ("-xc -std=c11", "-xc++ -std=c++17"):
            headers = [name for name in names if name.endswith(".h") or standard.startswith("-xc++")]
            lines = "".join(f'#include "{name}"\n' for name in headers)
            command = [
                "g++" if standard.startswith("-xc++") else "gcc",
                *standard.split(),
                *(f"-I{folder}/{root}" for root in roots),
                "-Werror",
                "-fsyntax-only",
                "-",
            ]
            done = subprocess.run(command, input=lines, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr[:2000]


def _each(parse: Callable[[str], Any]) -> Callable[[Mapping[str, str]], None]:
    def accepts(texts: Mapping[str, str]) -> None:
        for text in texts.values():
            parse(text)

    return accepts


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


ST_WORDS = _words("""
    TYPE TIME ACTION TASK FUNCTION STEP TRANSITION DT ARRAY AT READ_ONLY PROGRAM CONFIGURATION RESOURCE INTERVAL
    PRIORITY STRING BOOL BYTE LOG TRUE FALSE ADD DELETE ON VAR END_VAR AND OR NOT XOR MOD TO OF BY REAL LREAL LWORD
    ULINT USINT WSTRING LTIME DATE TOD LIMIT MAX MIN SEL MUX SIZEOF ADR POINTER REFERENCE STRUCT UNION CLASS METHOD
    PROPERTY INTERFACE THIS SUPER NULL REF_TO USING NAMESPACE PERSISTENT RETAIN IF THEN ELSE FOR WHILE REPEAT UNTIL
    CASE RETURN EXIT CONTINUE
""")
"""IEC 61131-3, edition 3, and the help of CODESYS."""
C_WORDS = _words("""
    auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    class template typename this throw try new delete private public protected virtual operator friend namespace using
    bool true false and or not xor export mutable explicit asm nullptr constexpr static_assert linux unix
""")
"""The keywords of C11 and C++17, and names that gcc defines by default."""

_NAME = r"[A-Za-z_]\w*"
_IN_ST = r"_?[A-Za-z0-9]+(_[A-Za-z0-9]+)*_?"
"""A name without two underscores in a row, which CODESYS reserves for itself."""
_IN_MATIEC = _IN_ST.removesuffix("_?")

_PYTHON = Language(python_tokens, _python, frozenset(keyword.kwlist), name=_NAME)
_C = Language(c_tokens, _c, C_WORDS, name=_NAME)
_BESIDE_ROS = Language(c_tokens, keywords=C_WORDS, name=_NAME)
"""tests/cpp/test_ros.py has ROS's headers, tests/ros2/test_cpp_node.py rclcpp."""
_ST = Language(st_tokens, keywords=ST_WORDS, ignores_case=True, name=_IN_ST)
_XML = Language(xml_tokens)
_CONFIGURATION = Language(_hash)

LANGUAGES = [
    ("*/launch/*.py", Language(python_tokens, _python)),  # with no name of a message
    ("*.py", _PYTHON),
    ("ros2_control/*/include/shmgen_control.hpp", Language(lambda text: [])),  # by hand, with rclcpp's words
    (
        "c/*/shmgen_library.*",
        Language(lambda text: []),
    ),  # by hand: tests/test_builds.py
    *((path, _BESIDE_ROS) for path in ("cpp_ros?/*", "ros2_c*/include/*", "ros2_c*/src/*")),
    ("matiec/*.h", Language(type_tokens, _c, C_WORDS, name=_NAME)),
    ("*.h", _C),
    ("*.hpp", _C),
    ("matiec/*.st", Language(matiec_tokens, _open_plc, ST_WORDS, ignores_case=True, name=_IN_MATIEC)),
    ("*.stlib", Language(stlib_tokens, _open_plc, C_WORDS, name=_NAME)),
    ("*.st", _ST),
    ("plcopen/*.xml", Language(xml_tokens, keywords=ST_WORDS, ignores_case=True, name=_IN_ST)),
    ("*.xml", _XML),
    ("*.launch", _XML),
    ("*.xacro", Language(lambda text: [], _each(etree.fromstring))),  # fields stand in it as ROS names them
    ("*.toml", Language(_hash, _each(tomllib.loads))),
    ("*.yaml", Language(_hash, _each(YAML(typ="safe").load))),
    ("*.cfg", Language(_hash, _each(lambda text: configparser.ConfigParser(interpolation=None).read_string(text)))),
    ("*/CMakeLists.txt", _CONFIGURATION),
    ("ros1/*/scripts/bridge", _PYTHON),
    ("*/py.typed", _CONFIGURATION),
    ("ros2/*/resource/*", _CONFIGURATION),
    ("*/config/msgs/*", Language(lambda text: [])),  # the user's own files, copied
]
"""All languages. The first that matches a path is used."""
