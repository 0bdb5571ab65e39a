"""Hints for definitions that use the syntax of another language. A hint is only added to an error."""

from __future__ import annotations

import re

from shmgen.core.diagnostics import closest
from shmgen.core.model import OTHER_NAMES, Scalar

_BUILTIN = (*(scalar.value for scalar in Scalar), "string", "wstring", "byte", "char")
_IN_IDL = {"bool": "boolean", "float32": "float", "float64": "double", "byte": "octet", "uint8[]": "sequence<uint8>"}
_FIRST = "write the type first: `float64 x`"
_MSG_HINTS = (
    (r"//|/\*", "begin a comment with `#`"),
    (r";", "remove the `;`: the end of the line ends a declaration"),
    (r"^\s*(const|constexpr|static|optional|unsigned|signed)\s", "remove the word before the type"),
    (
        r"^\s*(enum|struct|union|class|typedef)\b",
        "write one message in a file, without a keyword, and an enumeration as constants: `uint8 NAME=1`",
    ),
    (r"^\s*\w+(::|\.)\w", "write a type of another package as `package/Name`"),
    (r"^\s*\w+\s*<\s*[a-zA-Z]", "write a sequence as `T[]`, or as `T[<=N]` with a bound"),
    (r"^\s*\w*string\s*\(|^\s*[\w/]+\s*\[?<\s*\d", "write a bound as `string<=N`, or as `T[<=N]` for a sequence"),
    (r"^\s*[\w/]+[*&]", "use `string` for text and `T[]` for a sequence: ROS has no pointers"),
    (r"^\s*\w+\s*:(?!:)", _FIRST),
    (rf"^\s*\w+\s+(?:\w+/\w+|(?:{'|'.join(_BUILTIN)})\s*$)", _FIRST),
    (r"^\s*[\w/]+\s+\w+\s*,", "write each field on its own line"),
    (r"[\s=][+-]?(?:0[xX])?[0-9a-fA-F]+_[0-9a-fA-F_]*\s*$", "write a number without `_`: `1000`"),
    (r"^\s*\w+\s+[A-Z][A-Z0-9_]*\s+\S", "write a constant with `=`: `uint8 NAME=1`"),
    (r"^\s*u?(?:int|float)\d+\s+[a-z]\w*\s+[a-z]\w*\s*$", "replace the blank in the name by `_`"),
    (r"^\s*\w+\s*$", "write a field as a type and a name: `float64 x`"),
)
"""Patterns of rejected lines, each with a hint."""
_IDL_HINTS = (
    (r"(?<!\w)#(?!\s*(include|pragma|define|if|endif|else)\b)", "begin a comment with `//`"),
    (r"^\s*map\s*<", "use one sequence for the keys and one for the values: ROS has no maps"),
    (r"^\s*[\w:]+\s*\[\s*\w*\s*\]\s*\w", "write the brackets after the name: `double x[3]`"),
    (r"<=", "write a bound as `string<N>`, or as `sequence<T, N>` for a sequence"),
    (r"^\s*[\w:]+/\w", "write a type of another package as `package::msg::Name`"),
    (r"^\s*\w+\s*:(?!:)", "write the type first: `double x;`"),
    (
        r"^\s*(fixed|any|Object|native|valuetype|interface)\b",
        "use a number, string, sequence, array or structure: ROS has no other types",
    ),
)


def hint(line: str) -> str:
    """Return hints for a rejected line of a .msg, or `""` if the line resembles no other language."""
    if odd := next((sign for sign in line.partition("#")[0] if sign.isspace() and sign not in " \t"), ""):
        return f"U+{ord(odd):04X} looks like a blank but is another character: replace it by a blank"
    code = line.partition("#")[0]
    return "\n".join(dict.fromkeys(advice for pattern, advice in _MSG_HINTS if re.search(pattern, code)))


def idl_hint(line: str, before: str) -> str:
    """Return a hint for a rejected line of an .idl file. `before` is the text of the file before the error."""
    if "module" not in before + line:
        return "write `module package { module msg { struct Name { double x; }; }; };`, or use a .msg file"
    suggestion = next((advice for pattern, advice in _IDL_HINTS if re.search(pattern, line)), "")
    if before.rstrip().endswith("{") and line.lstrip().startswith("}"):
        return "add a field: ROS uses `uint8 structure_needs_at_least_one_member;` in an empty structure"
    if suggestion or before.rstrip()[-1:] in (";", "{", ""):
        return suggestion or "write a field as a type and a name: `double x;`"
    return "put a `;` before this: a field ends with `;`, a structure and a module with `};`"


def builtin(word: str) -> str:
    """Return the ROS type that a word probably means, or `""`: `float64` for `double`, `LREAL` or `flaot64`."""
    small = word.lower()
    near = small if small in _BUILTIN else closest(small, _BUILTIN, 0.8)
    return OTHER_NAMES.get(word, "") or near or OTHER_NAMES.get(word.upper(), "")


def builtin_of_idl(word: str) -> str:
    """Return the IDL type that a word probably means, or `""`: `double` for `float64`, `LREAL` or `duoble`."""
    spelled = {_IN_IDL.get(name, name) for name in _BUILTIN}
    ros = word if word in _IN_IDL else OTHER_NAMES.get(word, "")
    return (
        _IN_IDL.get(ros, ros) or closest(word.lower(), spelled, 0.8) or _IN_IDL.get(ros_type := builtin(word), ros_type)
    )
