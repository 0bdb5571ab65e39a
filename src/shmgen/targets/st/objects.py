"""What an IDE stores of Structured Text: data types, lists of variables, blocks and programs with their methods.

The target st plans these and prints them; who comes after it takes them as they are.
"""

from __future__ import annotations

from typing import NamedTuple


class Attribute(NamedTuple):
    """`{attribute 'name' := 'value'}`, or without a value."""

    name: str
    value: str = ""

    @property
    def text(self) -> str:
        """As Structured Text spells it."""
        return f"{{attribute '{self.name}' := '{self.value}'}}" if self.value else f"{{attribute '{self.name}'}}"


class Head(NamedTuple):
    """What stands above an object: its comment, lines without `//`, and its attributes."""

    comment: tuple[str, ...]
    attributes: tuple[Attribute, ...] = ()


class Variable(NamedTuple):
    """`name : type := value;`, a member of a structure, or a name of an enumeration, which has no type.

    The value of an array is a tuple, that of each element.
    """

    name: str
    type: str
    value: str | tuple[str, ...]
    comment: str


class Variables(NamedTuple):
    """One section; `keyword` is VAR, VAR_INPUT, VAR_OUTPUT or VAR_GLOBAL."""

    keyword: str
    constant: bool
    variables: tuple[Variable, ...]

    @property
    def text(self) -> str:
        """`VAR_GLOBAL CONSTANT`."""
        return f"{self.keyword} CONSTANT" if self.constant else self.keyword


class DataType(NamedTuple):
    """A structure, an enumeration over the type `base`, or another name for the type `alias`."""

    name: str
    head: Head
    members: tuple[Variable, ...]
    base: str = ""
    initial: str = ""
    alias: str = ""


class GlobalList(NamedTuple):
    """A list of global variables or constants."""

    name: str
    head: Head
    variables: Variables


class Unit(NamedTuple):
    """A FUNCTION_BLOCK, PROGRAM or METHOD. Its text is `declaration`, `body`, and END_ with `keyword`."""

    keyword: str
    name: str
    access: str
    returns: str
    head: Head
    sections: tuple[Variables, ...]
    declaration: str
    body: str
    methods: tuple[Unit, ...] = ()


# --- as they are printed --------------------------------------------------------------------------------


class Line(NamedTuple):
    """A declaration with the comment beside it, and the comment lines that stand above it."""

    text: str
    above: tuple[str, ...] = ()


class Dut(NamedTuple):
    """A structure; `doc` are comment lines."""

    object: DataType
    doc: tuple[str, ...]
    members: tuple[Line, ...]


class Gvl(NamedTuple):
    """A list of variables, the generator's and, below a gap, the user's; `doc` are comment lines."""

    object: GlobalList
    doc: tuple[str, ...]
    generated: tuple[Line, ...]
    declared: tuple[Line, ...] = ()

    @property
    def has_gap(self) -> bool:
        return bool(self.declared)
