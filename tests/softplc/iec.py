"""The types of IEC 61131-3 that a variable can have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

ELEMENTARY = (
    "BOOL", "BYTE", "WORD", "DWORD", "LWORD", "SINT", "INT", "DINT", "LINT", "USINT", "UINT", "UDINT", "ULINT",
    "REAL", "LREAL", "TIME", "LTIME",
)  # fmt: skip


@dataclass(frozen=True)
class Elementary:
    name: str


@dataclass(frozen=True)
class Text:
    """The type STRING(length) or WSTRING(length)."""

    length: int
    wide: bool


@dataclass(frozen=True)
class Named:
    """A type with a name in capitals: a structure, an enumeration or a block."""

    name: str


@dataclass(frozen=True)
class Pointer:
    to: Type


@dataclass(frozen=True)
class Array:
    first: int
    last: int
    of: Type


Type: TypeAlias = "Elementary | Text | Named | Pointer | Array"
