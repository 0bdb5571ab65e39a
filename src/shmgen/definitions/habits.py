"""Hints for what other languages have people type in a definition: only for what is rejected anyway."""

from __future__ import annotations

import re

from shmgen.core.diagnostics import closest
from shmgen.core.model import Scalar

_BUILTIN = (*(scalar.value for scalar in Scalar), "string", "wstring", "byte", "char")
_SAME = (
    "BOOL:bool BYTE:uint8 WORD:uint16 DWORD:uint32 LWORD:uint64 STRING:string WSTRING:wstring boolean:bool str:string "
    "int:int32 integer:int32 long:int64 uint:uint32 float:float32 double:float64 wchar:uint16"
)
_OTHER_NAMES = {scalar.iec: scalar.value for scalar in Scalar} | {f"{name}_t": name for name in _BUILTIN}
_OTHER_NAMES |= dict(pair.split(":") for pair in _SAME.split())
_FIRST = "the type comes first: `float64 x`"
_HABITS = (
    (r"//|/\*", "a comment begins with `#`"),
    (r";", "the end of the line ends a declaration: take the `;` away"),
    (r"^\s*(const|constexpr|static|optional|unsigned|signed)\s", "a declaration is a type and a name, nothing before"),
    (r"^\s*(enum|struct|union|class|typedef)\b", "a file is one message; an enumeration is constants: `uint8 NAME=1`"),
    (r"^\s*\w+(::|\.)\w", "a type of another package is `package/Name`"),
    (r"^\s*\w+\s*<\s*[a-zA-Z]", "a sequence is `T[]`, or `T[<=N]` with a bound"),
    (r"^\s*\w*string\s*\(|^\s*[\w/]+\s*\[?<\s*\d", "a bound is `string<=N`, of a sequence `T[<=N]`"),
    (r"^\s*[\w/]+[*&]", "there are no pointers: text is `string`, a sequence `T[]`"),
    (r"^\s*\w+\s*:(?!:)", _FIRST),
    (rf"^\s*\w+\s+(?:\w+/\w+|(?:{'|'.join(_BUILTIN)})\s*$)", _FIRST),
    (r"^\s*[\w/]+\s+\w+\s*,", "one field a line"),
    (r"^\s*\w+\s+[A-Z][A-Z0-9_]*\s+\S", "a constant is written with `=`: `uint8 NAME=1`"),
    (r"^\s*u?(?:int|float)\d+\s+[a-z]\w*\s+[a-z]\w*\s*$", "a name is one word: put `_` where the blank is"),
    (r"^\s*\w+\s*$", "a field is a type and a name: `float64 x`"),
)
"""What a line that is rejected looks like, and what to do."""


def hint(line: str) -> str:
    """What may have been meant; nothing where the line follows no other language."""
    code = line.partition("#")[0]
    return "\n".join(dict.fromkeys(said for pattern, said in _HABITS if re.search(pattern, code)))


def builtin(word: str) -> str:
    """`float64` of `double`, `LREAL`, `flaot64`; nothing if it is like none."""
    return _OTHER_NAMES.get(word, "") or closest(word.lower(), _BUILTIN, 0.8)
